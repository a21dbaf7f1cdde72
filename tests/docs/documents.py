"""What the checks of the documents in docs/ have in common.

A check is a function from two texts, the module's and the document's, to a
list of complaints, so that tests can show that it finds what is wrong in
changed copies.
"""

from __future__ import annotations

import ast
import configparser
import importlib.util
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Optional

Check = Callable[[str, str], list[str]]

OPTIONS = "Which options are there?"
COMMANDS = "Which commands are there?"
STATUS = "What can macros read?"
MESSAGES = "What does this message mean?"

# The document


def headings(text: str) -> list[tuple[int, str, str]]:
    """(level, title, what stands below it up to a heading as high)."""
    block = re.compile(r"```.*?```", re.DOTALL)
    plain = block.sub(lambda match: "\n" * match[0].count("\n"), text)
    lines, plain_lines = text.splitlines(), plain.splitlines()
    found = [
        (number, len(match[1]), match[2])
        for number, line in enumerate(plain_lines)
        if (match := re.match(r"(#+) (.*)", line))
    ]
    result = []
    for number, level, title in found:
        ends = [n for n, other, _ in found if n > number and other <= level]
        end = ends[0] if ends else len(lines)
        result.append((level, title, "\n".join(lines[number + 1 : end])))
    return result


def part(text: str, title: str) -> str:
    """What stands below a heading."""
    (body,) = [body for _, name, body in headings(text) if name == title]
    return body


def rows(text: str) -> Iterator[list[str]]:
    """The cells of every row of every table, without the table's heading."""
    lines = text.splitlines()
    for number, line in enumerate(lines):
        after = lines[number + 1] if number + 1 < len(lines) else ""
        if line.startswith("|") and not (
            line.startswith("|---") or after.startswith("|---")
        ):
            yield [cell.strip() for cell in line.strip("|").split("|")]


def spans(text: str) -> list[str]:
    """What is written as code."""
    return re.findall(r"`([^`]+)`", text)


class Option(NamedTuple):
    """A row of a table of options."""

    name: str
    default: str
    range: str


def options_of(text: str) -> list[Option]:
    """The rows of all tables of options in a text."""
    return [Option(*spans(row[0]), *row[1:3]) for row in rows(text)]


# The module


class Source(NamedTuple):
    """A module, parsed and loaded."""

    tree: ast.Module
    module: Any


@lru_cache(maxsize=None)
def load(name: str, code: str) -> Source:
    """A module from its text."""
    spec = importlib.util.spec_from_loader(name, loader=None)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    tree = ast.parse(code)
    exec(compile(tree, f"{name}.py", "exec"), module.__dict__)
    return Source(tree, module)


class Section:
    """As much of the host's configuration as the module uses; records it."""

    error = configparser.Error

    def __init__(self, name: str, sections: dict[str, dict[str, str]]):
        self.name = name
        self.sections = sections
        self.read: set[str] = set()
        self.templates: set[str] = set()
        self.commands: set[str] = set()

    def get_name(self) -> str:
        return self.name

    def get(self, name: str, *default: Any, **_: Any) -> Any:
        self.read.add(name)
        options = self.sections.get(self.name, {})
        if name not in options and not default:
            raise self.error(f"{name} is missing")
        return options.get(name, *default)

    def getfloat(self, name: str, *default: Any, **_: Any) -> Optional[float]:
        value = self.get(name, *default)
        return None if value is None else float(value)

    def getboolean(self, name: str, *default: Any) -> bool:
        return self.get(name, *default) == "true"

    def get_prefix_options(self, prefix: str) -> list[str]:
        given = self.sections.get(self.name, {})
        return [name for name in given if name.startswith(prefix)]

    def has_section(self, name: str) -> bool:
        return name in self.sections

    def getsection(self, name: str) -> Section:
        return Section(name, self.sections)

    def get_printer(self) -> Any:
        return FakePrinter(self)


class FakePrinter:
    """Every object of the printer at once, as far as loading needs it."""

    command_error = RuntimeError

    def __init__(self, section: Section):
        self.section = section

    def lookup_object(self, *_: Any) -> FakePrinter:
        return self

    def load_object(self, *_: Any) -> FakePrinter:
        return self

    def register_event_handler(self, *_: Any) -> None:
        pass

    def register_command(self, name: str, *_: Any, **__: Any) -> None:
        self.section.commands.add(name)

    def register_endstop(self, *_: Any) -> None:
        pass

    def allow_multi_use_pin(self, *_: Any) -> None:
        pass

    def setup_pin(self, *_: Any) -> FakePrinter:
        return self

    def respond_info(self, *_: Any) -> None:
        pass

    def load_template(self, config: Section, name: str, *default: Any) -> str:
        self.section.templates.add(name)
        return config.get(name, *default)


# Takes options and loads the module with them; a refusal is an error
Configure = Callable[[dict[str, str]], Any]


def option_name_problems(read: set[str], written: list[str]) -> list[str]:
    """What a document lists is what the module reads."""
    return (
        [f"not in the document: {name}" for name in sorted(read - set(written))]
        + [f"not in the code: {name}" for name in set(written) - read]
        + [f"twice: {name}" for name in written if written.count(name) > 1]
    )


def known_option_problems(
    section: str, known: Sequence[str], read: set[str], configure: Configure
) -> list[str]:
    """What a module takes for an option is what it reads, and no more."""
    found = [f"read, but refused: {name}" for name in sorted(read - set(known))]
    found += [f"known, not read: {name}" for name in set(known) - read]
    found += [f"twice: {name}" for name in known if known.count(name) > 1]
    remedies = {f"{name}_": f"is '{name}' meant?" for name in known}
    remedies["zzz"] = "remove it"
    for option, remedy in remedies.items():
        message = refusal(configure, {option: "1"})
        where = f"Option '{option}' in section '{section}'"
        if message != f"{where} is not known; {remedy}":
            found.append(f"{option}: {message or 'is taken'}")
    return found


def refusal(configure: Configure, own: dict[str, str]) -> str:
    """Why a configuration is not taken; empty: it is."""
    try:
        configure(own)
    except configparser.Error as error:
        return str(error)
    return ""


def literal_problem(default: str, value: Any) -> str:
    """A default that is written as the value itself."""
    words = spans(default)[0]
    if words in ("true", "false"):
        return "" if value is (words == "true") else f"is {value}"
    if isinstance(value, str):
        return "" if value == words else f"is {value}"
    numbers = tuple(float(word) for word in words.split(","))
    is_value = value if isinstance(value, tuple) else (value,)
    return "" if numbers == is_value else f"is {value}"


def samples_of(words: str) -> tuple[list[str], list[str]]:
    """Range -> (texts that are taken, texts that are not)."""
    number = r"(-?[\d.]+)"
    if match := re.match(rf"(?:mm/s²|mm/s|mm|count), ([>≥]) {number}", words):
        limit = float(match[2])
        if words.startswith("count"):
            return [f"{limit:g}"], [f"{limit - 1:g}", "2.5"]
        below = [f"{limit - 0.001:g}", "x", "nan"]
        if match[1] == "≥":
            return [f"{limit:g}"], below
        return [f"{limit + 0.5:g}"], [f"{limit:g}", f"{limit - 1:g}", *below]
    if match := re.fullmatch(rf"(?:mm, )?{number} to {number}", words):
        low, high = float(match[1]), float(match[2])
        beyond = [f"{low - 0.001:g}", f"{high + 0.001:g}"]
        return [f"{low:g}", f"{high:g}"], [*beyond, "x", "nan"]
    if words == "X, Y in mm":
        return ["5, -5"], ["5", "5, x", "1, 2, 3"]
    if words == "low, high in mm":
        taken = ["-0.5, 0.7", "0.5", "-0.5", "0, 1", "0.1, 1"]
        return taken, ["0, 0", "0", "1, -1"]
    if words == "mm":
        return ["-1"], ["x", "inf"]
    choices = spans(words)
    return choices, ["x"] if choices else []


def range_problems(
    ranges: Mapping[str, str],
    configure: Configure,
    besides: Callable[[str], dict[str, str]] = lambda _: {},
) -> list[str]:
    """Options that take what their range excludes, or refuse what is in it.

    besides: what else has to be given with an option.
    """
    found = []
    for name, words in ranges.items():
        taken, refused = samples_of(words)
        if not taken and words not in ("G-code", "pin"):
            found.append(f"{name}: a range of no known kind: {words}")
        for value in taken + refused:
            error = refusal(configure, {**besides(name), name: value})
            if error and value in taken:
                found.append(f"{name}: {value} is refused: {error}")
            elif not error and value in refused:
                found.append(f"{name}: {value} is taken")
    return found


# Commands


def methods(source: Source, name: str) -> dict[str, ast.FunctionDef]:
    (found,) = [
        node
        for node in source.tree.body
        if isinstance(node, ast.ClassDef) and node.name == name
    ]
    return {n.name: n for n in found.body if isinstance(n, ast.FunctionDef)}


def parameters(
    source: Source, cls: str, command: str, asking: Callable[[str, str], str]
) -> set[str]:
    """What the methods that a command calls ask the command for.

    asking: (what is called, its first text) -> the parameter, or nothing.
    """
    own = methods(source, cls)
    pending, seen, found = ["cmd_" + command], set(), set()
    while pending:
        name = pending.pop()
        if name in seen or name not in own:
            continue
        seen.add(name)
        for node in ast.walk(own[name]):
            if isinstance(node, ast.Attribute):
                pending.append(node.attr)
            if not isinstance(node, ast.Call):
                continue
            texts = [
                argument.value
                for argument in node.args
                if isinstance(argument, ast.Constant)
                and isinstance(argument.value, str)
            ]
            if texts:
                found.add(asking(ast.unparse(node.func), texts[0]))
    return found - {""}


def command_problems(
    text: str, registered: set[str], asked: Callable[[str], set[str]]
) -> list[str]:
    """Commands with a heading of their own, and the parameters below it."""
    section = part(text, COMMANDS)
    documented = {title for _, title, _ in headings(section)}
    found = [f"command: {name}" for name in documented ^ registered]
    for name in sorted(documented & registered):
        written = {spans(r[0])[0] for r in rows(part(text, name))}
        found += [f"{name}: {word}" for word in sorted(written ^ asked(name))]
    return found


# Status


class Anything:
    """Has every attribute and answers every call with nothing."""

    def __getattr__(self, name: str) -> Callable[..., str]:
        return lambda *_: ""


def phases(source: Source) -> set[str]:
    return {"idle"} | {
        argument.value
        for node in ast.walk(source.tree)
        if isinstance(node, ast.Call)
        and ast.unparse(node.func) == "self.watch.enter"
        for argument in node.args
        if isinstance(argument, ast.Constant)
    }


def status_problems(
    text: str, fields: Mapping[str, Any], words: Mapping[str, set[str]]
) -> list[str]:
    """The table of fields; words: what is named in the row of a field."""
    section = part(text, STATUS)
    table = {spans(r[0])[0]: r[1] for r in rows(section)}
    found = [f"field: {name}" for name in set(table) ^ set(fields)]
    for field, real in words.items():
        shown = set(spans(table.get(field, "")))
        found += [f"{field}: {name}" for name in shown ^ real]
    (macro,) = re.findall(r"```ini\n(.*?)```", section, re.DOTALL)
    for name, below in re.findall(r"\bz\.(\w+)(?:\.(\w+))?", macro):
        if name not in fields or (below and below not in fields[name]):
            found.append(f"the macro uses {name}.{below}")
    return found


# Messages

# Their texts are not shown, or by the host under another heading
SILENT = ("collections.namedtuple", "logging.info", "logging.exception")
VALUE = "\0"


def messages(source: Source) -> set[str]:
    """Every text of more than one word that a user may see, in pieces."""
    silent: set[int] = set()
    for node in ast.walk(source.tree):
        quiet = isinstance(node, ast.Call) and (
            ast.unparse(node.func) in SILENT
            or ast.unparse(node.func).endswith(".always")
        )
        quiet = quiet or (
            isinstance(node, ast.Assign)
            and ast.unparse(node.targets[0]).endswith("_help")
        )
        if quiet:
            silent |= {id(inner) for inner in ast.walk(node)}
    texts = {
        normal(re.sub(r"%(?:\.\d+)?[sdfg]", VALUE, node.value))
        for node in ast.walk(source.tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in silent
        and " " in node.value.strip()
    }
    return {
        text
        for text in texts
        if re.search("[a-zA-Z]{2}", text) and "MOVE=0" not in text
    }


def normal(text: str) -> str:
    return " ".join(text.split())


def message_problems(text: str, known: set[str]) -> list[str]:
    """The first column lists messages; they may be explained elsewhere."""
    section = part(text, MESSAGES)
    first = {
        normal(re.sub(r"<[^<>]+>", VALUE, span))
        for row in rows(section)
        for span in spans(row[0])
    }
    # A message may be explained in the row of the one it is a part of
    everywhere = {
        normal(re.sub(r"<[^<>]+>", VALUE, span))
        for row in rows(section)
        for cell in row
        for span in spans(cell)
    }
    return [
        f"not in the document: {message.replace(VALUE, '<...>')}"
        for message in sorted(known - everywhere)
    ] + [
        f"not in the code: {message.replace(VALUE, '<...>')}"
        for message in sorted(first - known)
    ]


def template(source: Source, start: str) -> str:
    """The one text of a module that begins so."""
    (found,) = [
        node.value
        for node in ast.walk(source.tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and node.value.startswith(start)
    ]
    return found


# Numbers


def constants(source: Source) -> dict[str, Any]:
    return {
        name: value
        for name, value in vars(source.module).items()
        if re.fullmatch("[A-Z][A-Z_]+", name)
        and (
            isinstance(value, float)
            or (
                isinstance(value, tuple)
                and all(isinstance(item, float) for item in value)
            )
        )
    }


def constant_problems(source: Source, text: str) -> list[str]:
    """The table of built-in numbers, and where they are named in a sentence."""
    table = {
        spans(r[0])[0]: tuple(float(word) for word in r[1].split(","))
        for r in rows(part(text, "Built-in numbers"))
    }
    real = {
        name: value if isinstance(value, tuple) else (value,)
        for name, value in constants(source).items()
    }
    found = [f"only in one: {name}" for name in set(table) ^ set(real)]
    found += [
        f"{name} is {real[name]}"
        for name in set(table) & set(real)
        if table[name] != real[name]
    ]
    for name, number in re.findall(r"`([A-Z_]+)`\s+\((-?[\d.]+) mm\)", text):
        if real.get(name) != (float(number),):
            found.append(f"{name} is not {number}")
    for name in set(re.findall(r"`([A-Z]+_[A-Z_]+)` \(", text)) - set(real):
        found.append(f"there is no {name}")
    return found


# Links, examples


def anchors(text: str) -> set[str]:
    """What GitHub makes of the headings."""
    return {
        re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
        for _, title, _ in headings(text)
    }


def link_problems(
    text: str, document: Path, picture: Optional[Path] = None
) -> list[str]:
    """Links to files and headings, and whether the picture is shown."""
    found = []
    for target in re.findall(r"\]\(([^)]+)\)", text):
        path, _, anchor = target.partition("#")
        if target.startswith("http"):
            continue
        if path and not (document.parent / path).exists():
            found.append(f"no file: {target}")
        elif anchor:
            other = text
            if path:
                other = (document.parent / path).read_text(encoding="utf-8")
            if anchor not in anchors(other):
                found.append(f"no heading: {target}")
    if picture is not None and f"]({picture.name})" not in text:
        found.append("the picture is not shown")
    return found


def ini_blocks(text: str) -> dict[str, dict[str, str]]:
    """Every section that the document shows."""
    parser = configparser.ConfigParser(delimiters=":", interpolation=None)
    # Values keep their indentation; in a template it does not matter
    for block in re.findall(r"```ini\n(.*?)```", text, re.DOTALL):
        parser.read_string(block)
    return {
        name: {
            option: value.replace("\n", "\n  ")
            for option, value in parser[name].items()
        }
        for name in parser.sections()
    }


def told_by_module(lines: list[str]) -> list[str]:
    """Without the lines of the host's own probing, which differ."""
    own = [line for line in lines if not re.match("// probe(:| at) ", line)]
    return [line for line in own if line]


# Showing that a check sees something


class Change(NamedTuple):
    """What is changed in a text, and which check has to see it."""

    check: Check
    old: str
    new: str

    def of(self, text: str) -> str:
        changed, count = re.subn(self.old, self.new, text)
        assert count, self.old
        return changed
