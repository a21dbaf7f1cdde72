"""A program behind firmware.c: its time, its console, its lines."""

from __future__ import annotations

from pathlib import Path

import pytest

from simprinter import build_directory, firmware
from simprinter.clock import build_library
from simprinter.firmware import (
    FirmwareError,
    Process,
    StepLog,
    gpio_names,
)

from .programs import compile_c

SECOND = 10**9
# Every ms: lets a line rise and fall, looks at another, which ends it when it
# is set; says what it hears. Both generations of the GPIO interface.
SOURCE = r"""
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <linux/gpio.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <string.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

static int rang;
static void ring(int number) { (void)number; rang = 1; }

static int set(int line, int level)
{
    struct gpiohandle_data old = { { level } };
    struct gpio_v2_line_values new = { level, 1 };
    return (ioctl(line, GPIOHANDLE_SET_LINE_VALUES_IOCTL, &old)
            && ioctl(line, GPIO_V2_LINE_SET_VALUES_IOCTL, &new));
}

int main(void)
{
    int console, other, chip = open("/dev/gpiochip1", O_RDWR);
    openpty(&console, &other, NULL, NULL, NULL);
    struct gpio_v2_line_request out = { .offsets = { 4 }, .num_lines = 1
        , .config = { .flags = GPIO_V2_LINE_FLAG_OUTPUT } };
    struct gpiohandle_request in = { .lineoffsets = { 7 }, .lines = 1
        , .flags = GPIOHANDLE_REQUEST_INPUT };
    if (access("/dev/gpiochip1", F_OK) || ioctl(chip, GPIO_V2_GET_LINE_IOCTL, &out)
        || ioctl(chip, GPIO_GET_LINEHANDLE_IOCTL, &in))
        return 1;
    struct sigaction action = { .sa_handler = ring };
    sigaction(SIGALRM, &action, NULL);
    timer_t timer;
    timer_create(CLOCK_MONOTONIC, NULL, &timer);
    struct itimerspec next = { { 0, 0 }, { 1001, 0 } };
    timer_settime(timer, TIMER_ABSTIME, &next, NULL);
    struct pollfd poll = { console, POLLIN, 0 };
    for (;;) {
        char text[100];
        if (ppoll(&poll, 1, NULL, NULL) == 1)
            write(console, text, read(console, text, sizeof(text)));
        if (!rang)
            continue;
        rang = 0;
        set(out.fd, 1);
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        set(out.fd, 0);
        struct gpiohandle_data level;
        ioctl(in.fd, GPIOHANDLE_GET_LINE_VALUES_IOCTL, &level);
        if (level.values[0])
            return 2;
        next.it_value.tv_nsec += 1000000;
        timer_settime(timer, TIMER_ABSTIME, &next, NULL);
    }
}
"""
OUT, IN = 288 + 4, 288 + 7


@pytest.fixture
def begin(tmp_path):
    """Starts it; what it does to its outputs, and the times of its looks."""
    begun = []

    def start(look=lambda pin, ns: False):
        events, looks = [], []

        def looked(pin, ns):
            looks.append((pin, ns))
            return look(pin, ns)

        source = Path(firmware.__file__).with_name("firmware.c")
        library = build_library(build_directory(), source)
        (program,) = compile_c(SOURCE, tmp_path)
        process = Process(program, library, looked, events.extend)
        begun.append(process)
        return process, events, looks

    yield start
    for process in begun:
        process.close()


def test_lives_from_timer_to_timer_and_no_further(begin):
    process, events, looks = begin()
    process.live(1000 * SECOND, 1001 * SECOND + 2_500_000)
    rises = [1001 * SECOND + n * 1_000_000 for n in range(3)]
    assert looks == [(IN, ns + 20) for ns in rises]
    levels = [(event >> 13, event >> 1 & 0xFFF, event & 1) for event in events]
    toggles = [[(ns, OUT, 1), (ns + 20, OUT, 0)] for ns in rises]
    assert levels[1:] == [one for pair in toggles for one in pair]
    assert process.alarm == rises[-1] + 1_000_000


def test_goes_no_further_once_it_has_spoken(begin):
    process, _, looks = begin()
    assert process.live(1000 * SECOND, 1002 * SECOND, b"abc") == b"abc"
    assert process.now == 1000 * SECOND
    assert not looks


def test_end_of_the_program_is_told(begin):
    process, _, _ = begin(lambda pin, ns: ns > 1001 * SECOND + 1_000_000)
    with pytest.raises(FirmwareError, match="has ended"):
        process.live(1000 * SECOND, 1002 * SECOND)


def test_steps_are_counted_when_the_pin_rises():
    log = StepLog()
    for sign, ns in ((1, 10), (1, 20), (-1, 30)):
        log.sign = sign
        log.set_step(True, ns)
        log.set_step(True, ns + 1)
        log.set_step(False, ns + 2)
    assert [log.at(ns) for ns in (9, 10, 20, 29, 30)] == [0, 1, 2, 2, 1]
    log.forget(25)
    assert [log.at(ns) for ns in (20, 29, 30)] == [2, 2, 1]


def test_pins_get_the_names_of_lines():
    config = "pin: ^!PA3\nstep_pin: zboard:PI15\nname: PA16 SPA3"
    expected = "pin: ^!gpio3\nstep_pin: zboard:gpio143\nname: PA16 SPA3"
    assert gpio_names(config) == expected
