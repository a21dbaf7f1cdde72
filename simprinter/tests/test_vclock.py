"""The virtual clock under programs that wait in every way klippy does."""

from __future__ import annotations

import os
import time

import pytest

from simprinter import VirtualClock, build_directory, clock
from simprinter.mcu.board import Board
from simprinter.tests.programs import (
    Program,
    compile_c,
    python,
    run_python,
)
from simprinter.wire.framing import encode_block

SECOND = 10**9
HOUR = 3600 * SECOND


# What may be waited for
THINGS = """
reader, writer = os.pipe()
poll = select.poll()
poll.register(reader, select.POLLIN)
epoll = select.epoll()
epoll.register(reader, select.EPOLLIN)
event, items, held = threading.Event(), queue.Queue(), threading.Lock()
semaphore, condition = threading.Semaphore(0), threading.Condition()
sockets = socket.socketpair()
"""


@pytest.mark.parametrize(
    "wait",
    [
        "time.sleep(3600)",
        "select.select([], [], [], 3600)",
        "select.select([reader], [], [], 3600)",
        "poll.poll(3600_000)",
        "epoll.poll(3600)",
        "event.wait(3600)",
        "held.acquire(timeout=3600)",
        "condition.wait(3600)",
        "semaphore.acquire(timeout=3600)",
        "empty(lambda: items.get(timeout=3600))",
        "empty(lambda: sockets[0].recv(1))",
        "threading.enumerate()[-1].join(3600)",
    ],
)
def test_timed_wait_takes_its_time_exactly(wait):
    began = time.monotonic()
    source = f"""
held.acquire()
condition.acquire()
sockets[0].settimeout(3600)
threading.Thread(target=time.sleep, args=(5000,), daemon=True).start()
def empty(call):
    try:
        call()
    except (queue.Empty, socket.timeout):
        pass
wall = time.time_ns()
start = now()
{wait}
print(now() - start, time.time_ns() - wall)
"""
    assert run_python(THINGS + source) == [f"{HOUR} {HOUR}"]
    assert time.monotonic() - began < 36.0


@pytest.mark.parametrize(
    ("wait", "give"),
    [
        ("event.wait()", "event.set()"),
        ("event.wait(9)", "event.set()"),
        ("items.get()", "items.put(1)"),
        ("items.get(timeout=9)", "items.put(1)"),
        ("held.acquire()", "held.release()"),
        ("semaphore.acquire()", "semaphore.release()"),
        ("select.select([reader], [], [])", "os.write(writer, b'x')"),
        ("select.select([reader], [], [], 9)", "os.write(writer, b'x')"),
        ("poll.poll()", "os.write(writer, b'x')"),
        ("epoll.poll(9)", "os.write(writer, b'x')"),
        ("sockets[0].recv(1)", "sockets[1].send(b'x')"),
        ("select.select([reader], [], [])", "os.close(writer)"),
    ],
)
def test_another_thread_ends_a_wait_at_once(wait, give):
    source = f"""
held.acquire()
sockets[0].settimeout(9)
def waiter():
    {wait}
    print(now())
thread = threading.Thread(target=waiter)
thread.start()
time.sleep(2)
{give}
time.sleep(3)
thread.join()
print(now())
"""
    assert run_python(THINGS + source) == [str(2 * SECOND), str(5 * SECOND)]


def test_pipes_between_sleepers_are_never_overlooked():
    """The simulator looks all the time, also as the last one falls asleep."""
    source = """
reader, writer = os.pipe()
seen, sent = [], []
def receive():
    for _ in range(3000):
        select.select([reader], [], [], 10.0)
        os.read(reader, 1)
        seen.append(now())
thread = threading.Thread(target=receive)
thread.start()
for _ in range(3000):
    time.sleep(0.001)
    sent.append(now())
    os.write(writer, b"x")
thread.join()
print(seen == sent, now())
"""
    with Program(python(source)) as program:
        the_clock = program.simulation.clock
        while not program.simulation.process_ended():
            for _ in range(1000):
                wakes = the_clock.wakes()
                if the_clock.everybody_sleeps():
                    deadline = the_clock.next_deadline()
                    the_clock.advance(max(deadline, the_clock.now()), wakes)
        assert program.finish() == [f"True {3 * SECOND}"]


def test_many_sleepers_wake_in_order_and_on_time():
    source = """
woken = []
def sleep(n):
    for _ in range(50):
        time.sleep(n / 64)  # exact in us, too: select() has no finer
        woken.append((round(now() * 64 / 1e9), now(), n))
order = [1 + n * 7 % 40 for n in range(40)]
threads = [threading.Thread(target=sleep, args=(n,)) for n in order]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
times = [ticks for ticks, _, _ in woken]
print(len(woken), times == sorted(times))
print(all(abs(at - ticks * 10**9 // 64) < 5000 for ticks, at, _ in woken))
print(sorted((ticks, n) for ticks, _, n in woken)
      == sorted((n * k, n) for n in order for k in range(1, 51)))
"""
    assert run_python(source) == ["2000 True", "True", "True"]


def test_places_of_ended_threads_are_used_again_until_there_are_too_many():
    source = """
for _ in range(300):
    thread = threading.Thread(target=time.sleep, args=(1,))
    thread.start()
    thread.join()
print(now(), flush=True)
for _ in range(70):
    threading.Thread(target=time.sleep, args=(1000,), daemon=True).start()
time.sleep(1)
"""
    failure = pytest.raises(AssertionError, match="more than 64 threads")
    with Program(python(source)) as program, failure as caught:
        program.finish()
    # An error, not a wrong clock
    assert str(300 * SECOND) in str(caught.value)


def test_time_stands_still_while_a_thread_computes():
    source = """
def tick():
    while True:
        time.sleep(0.0001)
threading.Thread(target=tick, daemon=True).start()
begin = now()
while time.process_time() < 0.5: # the processor's time is real
    sum(range(1000))
print(now() - begin)
"""
    assert run_python(source) == ["0"]


def test_spinning_until_a_time_ends():
    source = """
def spin(ns):
    reads, end = 1, time.monotonic_ns() + ns
    while time.monotonic_ns() < end:
        reads += 1
    print(reads, now())
spin(300_000)
time.sleep(1)
print(now())
spin(200_000)
"""
    lines = [line.split() for line in run_python(source)]
    (reads, end), (slept,), (_, end2) = [
        [int(word) for word in line] for line in lines
    ]
    # After 1000 reads of one instant, a microsecond passes
    assert 300_000 <= end < 302_000
    assert reads > 100_000
    assert SECOND <= slept - end < SECOND + 2_000
    assert 200_000 <= end2 - slept < 202_000


def test_reading_the_clock_now_and_then_costs_nothing():
    source = """
times = {now() for _ in range(400)}
time.sleep(1)
times |= {now() for _ in range(400)}
print(sorted(times), time.strftime('%F', time.gmtime(time.time())))
"""
    # The date is a fixed one
    assert run_python(source) == [f"[0, {SECOND}] 2026-01-01"]


TALK = """
import tty
fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
tty.setraw(fd)
def tick():
    while True:
        time.sleep(0.001)
threading.Thread(target=tick, daemon=True).start()
def answer():
    data = b""
    while True: # blocks up to the acknowledgement, which is 5 bytes long
        if not select.select([fd], [], [], 7.0)[0]:
            return False
        data += os.read(fd, 4096)
        while data and data[0] <= len(data):
            if data[0] == 5:
                return True
            data = data[data[0]:]
good = 0
for line in sys.argv[2:]:
    begin = now()
    os.write(fd, bytes.fromhex(line))
    good += answer() and now() == begin
    time.sleep(0.25)
print(good, now())
"""


@pytest.mark.slow
def test_bytes_on_a_line_are_awaited():
    command = []

    def prepare(simulation):
        board = Board(simulation.clock.now, [])
        link = simulation.add_board(board)
        commands = board.dictionary.commands.values()
        uptime = next(m for m in commands if m.name == "get_uptime")
        content = uptime.encode({}) * 5
        blocks = [encode_block(n, content).hex() for n in range(200)]
        command.extend(python(TALK, link.path, *blocks))

    # Every answer comes at once: not after the timeout of the select(), nor
    # after a tick of the other thread
    with Program(command, prepare) as program:
        assert program.finish() == [f"200 {50 * SECOND}"]


C_PROGRAM = r"""
#define _GNU_SOURCE
#include <poll.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdio.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static long long start;
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t cond = PTHREAD_COND_INITIALIZER;
static sem_t sem;
static int stage, pipe_fds[2];

static long long clock_ns(clockid_t id) {
    struct timespec ts;
    clock_gettime(id, &ts);
    return ts.tv_sec * 1000000000LL + ts.tv_nsec;
}

static void tell(const char *what, int ret) {
    long long ms = (clock_ns(CLOCK_MONOTONIC) - start) / 1000000;
    printf("%s %d %lld\n", what, ret, ms);
}

static void *other(void *arg) {
    pthread_mutex_lock(&mutex);
    for (int wanted = 1; wanted <= 2; wanted++) {
        while (stage != wanted)
            pthread_cond_wait(&cond, &mutex);
        tell("stage", stage);
    }
    pthread_mutex_unlock(&mutex);
    tell("posted", sem_wait(&sem));
    struct pollfd pfd = { .fd = pipe_fds[0], .events = POLLIN };
    tell("poll", poll(&pfd, 1, -1));
    return arg;
}

static void enter(int next, int (*wake)(pthread_cond_t *)) {
    pthread_mutex_lock(&mutex);
    stage = next;
    wake(&cond);
    pthread_mutex_unlock(&mutex);
}

int main(void) {
    struct timespec ts = { 1, 500000000 }, wait = { 0, 750000000 };
    struct timeval tv;
    pthread_t thread;
    setbuf(stdout, NULL);
    start = clock_ns(CLOCK_MONOTONIC);
    if (sem_init(&sem, 0, 0) || pipe(pipe_fds))
        return 1;
    pthread_create(&thread, NULL, other, NULL);
    tell("nanosleep", nanosleep(&ts, NULL));
    tell("usleep", usleep(250000));
    long long end = clock_ns(CLOCK_REALTIME) + 1000000000LL;
    ts.tv_sec = end / 1000000000;
    ts.tv_nsec = end % 1000000000;
    tell("until", clock_nanosleep(CLOCK_REALTIME, TIMER_ABSTIME, &ts, NULL));
    ts.tv_sec++;
    tell("sem_timedwait", sem_timedwait(&sem, &ts));
    ts.tv_sec++;
    tell("sem_clockwait", sem_clockwait(&sem, CLOCK_REALTIME, &ts));
    tell("ppoll", ppoll(NULL, 0, &wait, NULL));
    gettimeofday(&tv, NULL);
    long long now = clock_ns(CLOCK_REALTIME) / 1000000000;
    tell("same date", tv.tv_sec == time(NULL) && tv.tv_sec == now);
    enter(1, pthread_cond_signal);
    usleep(1000000);
    enter(2, pthread_cond_broadcast);
    usleep(1000);
    sem_post(&sem);
    usleep(1000);
    if (write(pipe_fds[1], "x", 1) != 1)
        return 1;
    usleep(1000);
    return pthread_join(thread, NULL);
}
"""


def test_waits_of_c_programs(tmp_path):
    with Program(compile_c(C_PROGRAM, tmp_path)) as program:
        lines = program.finish()
    assert lines == [
        "nanosleep 0 1500",
        "usleep 0 1750",
        "until 0 2750",
        "sem_timedwait -1 3750",
        "sem_clockwait -1 4750",
        "ppoll 0 5500",
        "same date 1 5500",
        "stage 1 5500",
        "stage 2 6500",
        "posted 0 6501",
        "poll 1 6502",
    ]


# The simulator's side


def wait_until(true) -> None:
    """Poll in real time."""
    end = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_clock_moves_forwards_and_on_no_old_knowledge():
    source = """
threading.Thread(target=lambda: (time.sleep(1), time.sleep(3600))).start()
time.sleep(3600)
"""
    with Program(python(source)) as program:
        the_clock = program.simulation.clock
        wait_until(the_clock.everybody_sleeps)
        assert the_clock.joined()
        wakes, start = the_clock.wakes(), the_clock.now()
        assert the_clock.advance(start + 5, wakes)
        with pytest.raises(ValueError, match="forwards"):
            the_clock.advance(start + 4, wakes)
        assert the_clock.now() == start + 5
        assert the_clock.advance(the_clock.next_deadline(), wakes)
        # A thread wakes, and sleeps again
        wait_until(the_clock.everybody_sleeps)
        assert not the_clock.advance(the_clock.next_deadline(), wakes)
        assert the_clock.now() == start + SECOND
        assert the_clock.advance(the_clock.next_deadline(), the_clock.wakes())
        assert the_clock.now() == start + HOUR


def test_clock_without_a_process():
    the_clock = VirtualClock(build_directory())
    try:
        # It is awake before it has started
        assert not the_clock.everybody_sleeps()
        assert not the_clock.joined()
        now = the_clock.now()
        assert not the_clock.advance(now + 5, the_clock.wakes())
        assert the_clock.now() == now
        indexes = [the_clock.add_tty("/dev/null") for _ in range(8)]
        assert indexes == list(range(8))
        with pytest.raises(clock.ClockError, match="too many"):
            the_clock.add_tty("/dev/null")
    finally:
        the_clock.close()


def test_line_is_settled_when_both_ends_count_the_same():
    source = """
fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
os.write(fd, b"hello")
time.sleep(3600)
"""
    master, slave = os.openpty()
    command, indexes = [], []

    def prepare(simulation):
        path = os.ttyname(slave)
        indexes.append(simulation.clock.add_tty(path))
        command.extend(python(source, path))
        # Before the line is open nobody reads what is sent
        assert simulation.clock.tty_settled(indexes[0], 7, 0)

    with Program(command, prepare) as program:
        the_clock, (index,) = program.simulation.clock, indexes
        wait_until(the_clock.everybody_sleeps)
        assert the_clock.tty_settled(index, 0, 5)
        assert not the_clock.tty_settled(index, 0, 4)  # still on its way here
        assert not the_clock.tty_settled(index, 1, 5)  # on its way there
    os.close(master)
    os.close(slave)
