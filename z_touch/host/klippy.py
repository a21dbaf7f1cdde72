"""The types of klippy's objects, as far as they are used.

klippy is not imported: it is there when the modules run, and its objects are recognised
by what they can do.  What hosts do not share is asked with getattr or hasattr in this
folder, so it is missing here.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import (
    Any,
    Callable,
    ContextManager,
    Dict,
    List,
    Mapping,
    Optional,
    Protocol,
    Sequence,
    Tuple,
    Type,
    TypeVar,
)

T = TypeVar("T")
Status = Dict[str, Any]
Choice = Mapping[Any, T]


class Reactor(Protocol):
    """klippy's event loop."""

    NOW: float
    NEVER: float

    def monotonic(self) -> float:
        """Return the event time (s) of now."""

    def pause(self, waketime: float) -> float:
        """Let others run until an event time (s); return that of afterwards."""

    def register_timer(
        self, callback: Callable[[float], float], waketime: float = ...
    ) -> Any:
        """Call 'callback' at an event time (s); it returns when to call it again."""

    def update_timer(self, timer: Any, waketime: float) -> None:
        """Have a timer run at another event time (s), NEVER: not at all."""

    def register_callback(
        self, callback: Callable[[float], None], waketime: float = ...
    ) -> Any:
        """Call 'callback' once, in a greenlet of its own, which may pause."""


class Config(Protocol):
    """One section of printer.cfg."""

    error: Type[Exception]

    def get_printer(self) -> Printer:
        """Return the printer that the section belongs to."""

    def get_name(self) -> str:
        """Return the name of the section, such as 'stepper_z'."""

    def get(
        self, option: str, default: Any = ..., note_valid: bool = ...
    ) -> Any:
        """Return an option as it stands there; raises error without it and a default."""

    def getint(self, option: str, default: Any = ..., **limits: Any) -> Any:
        """Return an option as a whole number, within minval and maxval."""

    def getfloat(self, option: str, default: Any = ..., **limits: Any) -> Any:
        """Return an option as a number, within minval, maxval, above and below."""

    def getfloatlist(
        self,
        option: str,
        default: Any = ...,
        count: Optional[int] = ...,
        note_valid: bool = ...,
    ) -> Any:
        """Return an option as numbers; count: how many, None: any."""

    def getboolean(self, option: str, default: Any = ...) -> Any:
        """Return an option that is true or false."""

    def getchoice(
        self, option: str, choices: Mapping[Any, Any], default: Any = ...
    ) -> Any:
        """Return what 'choices' has for the option."""

    def has_section(self, section: str) -> bool:
        """Return whether the configuration has a section."""

    def getsection(self, section: str) -> Config:
        """Return a section, also one that is not there."""

    def get_prefix_sections(self, prefix: str) -> List[Config]:
        """Return the sections whose names begin so."""

    def get_prefix_options(self, prefix: str) -> List[str]:
        """Return the names of the options that begin so."""


class GCodeCommand(Protocol):
    """A command of G-code with its parameters."""

    error: Type[Exception]

    def get_command(self) -> str:
        """Return the name of the command."""

    def get_commandline(self) -> str:
        """Return the whole line."""

    def get(self, name: str, default: Any = ...) -> Any:
        """Return a parameter; raises error without it and a default."""

    def get_int(self, name: str, default: Any = ..., **limits: Any) -> Any:
        """Return a parameter as a whole number, within minval and maxval."""

    def get_float(self, name: str, default: Any = ..., **limits: Any) -> Any:
        """Return a parameter as a number, within minval, maxval, above and below."""

    def respond_info(self, msg: str, log: bool = ...) -> None:
        """Show a text on the console; log: in klippy.log, too."""


Handler = Callable[[GCodeCommand], None]


class Mutex(Protocol):
    """The lock that a command holds while it runs."""

    def __enter__(self) -> Any: ...
    def __exit__(self, *unused: Any) -> None: ...


class GCode(Protocol):
    """The object 'gcode': commands and the console."""

    gcode_help: Dict[str, str]
    ready_gcode_handlers: Dict[str, Any]

    def register_command(
        self,
        cmd: str,
        func: Optional[Handler],
        when_not_ready: bool = ...,
        desc: Optional[str] = ...,
    ) -> Optional[Handler]:
        """Have 'func' run a command, None: nothing; return what ran it before."""

    def register_mux_command(
        self,
        cmd: str,
        key: str,
        value: Optional[str],
        func: Handler,
        desc: Optional[str] = ...,
    ) -> None:
        """Have 'func' run a command where the parameter 'key' has that value."""

    def create_gcode_command(
        self, command: str, commandline: str, params: Mapping[str, str]
    ) -> GCodeCommand:
        """Return a command that was not sent."""

    def run_script_from_command(self, script: str) -> None:
        """Run G-code within a command that is running."""

    def respond_info(self, msg: str, log: bool = ...) -> None:
        """Show a text on the console; log: in klippy.log, too."""

    def respond_raw(self, msg: str) -> None:
        """Send a line as it is."""

    def register_output_handler(self, cb: Callable[[str], None]) -> None:
        """Have 'cb' called with each line of the console, for good."""

    def get_mutex(self) -> Mutex:
        """Return the lock that commands hold while they run."""


class Printer(Protocol):
    """The object that has all others."""

    config_error: Type[Exception]
    command_error: Type[Exception]

    def get_reactor(self) -> Reactor:
        """Return the event loop."""

    def get_start_args(self) -> Dict[str, Any]:
        """Return with what klippy was started, such as the path of printer.cfg."""

    def is_shutdown(self) -> bool:
        """Return whether the printer is shut down."""

    def get_state_message(self) -> Tuple[str, str]:
        """Return what the host says of its state, in lines, and the state in a word."""

    def invoke_shutdown(self, msg: str) -> None:
        """Shut the printer down, for a reason that the user reads."""

    def add_object(self, name: str, obj: Any) -> None:
        """Make an object known by a name."""

    def lookup_object(self, name: str, default: Any = ...) -> Any:
        """Return an object; raises config_error without it and a default."""

    def lookup_objects(
        self, module: Optional[str] = ...
    ) -> List[Tuple[str, Any]]:
        """Return names and objects of a module, None: of all."""

    def load_object(self, config: Config, section: str) -> Any:
        """Return the object of a section, which is loaded if it is not yet."""

    def register_event_handler(
        self, event: str, callback: Callable[..., Any]
    ) -> None:
        """Call 'callback' whenever an event is sent."""

    def send_event(self, event: str, *params: Any) -> Any:
        """Send an event; return what its handlers do."""


class Stepper(Protocol):
    """One motor."""

    def get_name(self) -> str:
        """Return the name of the section."""

    def get_step_dist(self) -> float:
        """Return the way of one microstep (mm)."""

    def get_mcu_position(self) -> int:
        """Return how many microsteps the board has counted."""

    def get_commanded_position(self) -> float:
        """Return where the motor is to be (mm, of the motor)."""

    def is_active_axis(self, axis: str) -> bool:
        """Return whether an axis ('x', 'y', 'z') moves the motor."""


class Kinematics(Protocol):
    """How the motors move the toolhead."""

    def get_steppers(self) -> List[Stepper]:
        """Return all motors."""


class ToolHead(Protocol):
    """The object 'toolhead': where it is, and plain moves (mm, mm/s)."""

    def get_position(self) -> List[float]:
        """Return X, Y, Z and E (mm) that were commanded last."""

    def set_position(
        self, newpos: Sequence[float], homing_axes: Any = ...
    ) -> None:
        """Declare where the toolhead is (mm), and which axes are homed by that."""

    def manual_move(
        self, coord: Sequence[Optional[float]], speed: float
    ) -> None:
        """Move to X, Y and Z (mm), None: as it is, at a speed (mm/s)."""

    def wait_moves(self) -> None:
        """Pause until all moves have ended."""

    def dwell(self, delay: float) -> None:
        """Let the toolhead stand for so long (s), after the moves before."""

    def get_last_move_time(self) -> float:
        """Return the print time (s) at which the last move ends."""

    def flush_step_generation(self) -> None:
        """Make the steps of all moves before."""

    def check_busy(self, eventtime: float) -> Tuple[float, float, bool]:
        """Return the print time (s), its estimate, and whether nothing waits."""

    def get_kinematics(self) -> Any:
        """Return how its motors move it."""

    def get_status(self, eventtime: float) -> Status:
        """Return what macros read of it."""


class Endstop(Protocol):
    """A pin that can stop motors."""

    def get_steppers(self) -> List[Stepper]:
        """Return the motors that it stops."""

    def add_stepper(self, stepper: Stepper) -> None:
        """Have it stop one more motor."""

    def query_endstop(self, print_time: float) -> Any:
        """Return whether it is triggered at a print time (s).  Pauses."""


class Template(Protocol):
    """G-code of the user, as [gcode_macro] has it."""

    def create_template_context(self) -> Dict[str, Any]:
        """Return what the template can read."""

    def run_gcode_from_command(
        self, context: Optional[Dict[str, Any]] = ...
    ) -> None:
        """Run it within a command; None: with what it can read by itself."""


Context = ContextManager[None]
