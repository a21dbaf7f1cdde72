// Hands the world of one micro-controller program, preloaded into it, to the
// simulator (LD_PRELOAD): its clock, its timer, its console and its GPIO lines.
//
// The program (Klipper's Linux process) is one thread that sleeps in ppoll()
// until its timer or its console wakes it. Its time is the simulator's: it
// stands still while the program sleeps, and moves on by one tick whenever the
// program reads it, so that a loop which waits for a moment gets there.
//
// The simulator says how far the program may live by itself; it then runs from
// timer to timer without asking. What it does to its outputs is noted with the
// time and handed over when it sleeps at the end of that, has said something on
// its console, or looks at an input: the answer to that comes from the
// simulator.
//
// 64-bit glibc only (see LIMITS.md).
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/gpio.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define NEVER INT64_MAX
#define TICK_NS 20
#define MAX_FDS 4096
#define MAX_EVENTS 65536
#define MAX_BYTES 65536
// Lines of one chip, as the program numbers its pins
#define CHIP_LINES 288

enum { STARTED, ASLEEP, LOOKS, FULL };

// To the simulator; events and console bytes follow
struct report {
    int32_t kind, pin, num_events, num_bytes;
    int64_t now, alarm;
};

// From it; console bytes follow
struct answer {
    int64_t now, until;
    int32_t level, num_bytes;
};

static int channel = -1;
static int console = -1;
static int64_t now, until, alarm_ns = NEVER;
static void (*on_alarm)(int);
// ns << 13 | pin << 1 | level
static int64_t events[MAX_EVENTS];
static int num_events;
static char heard[MAX_BYTES], said[MAX_BYTES];
static int num_heard, num_said;
// Of each descriptor: 0, -1 - number of a chip, or 1 + pin of a line
static int32_t opened[MAX_FDS];

static void
fail(const char *why)
{
    fprintf(stderr, "firmware: %s\n", why);
    _exit(1);
}

/****************************************************************
 * The simulator
 ****************************************************************/

static void
move_all(ssize_t (*move)(int, void *, size_t, int), void *data, size_t left)
{
    char *next = data;
    while (left) {
        ssize_t done = move(channel, next, left, 0);
        if (done < 0 && errno == EINTR)
            continue;
        if (done <= 0)
            _exit(0); // the simulation has ended
        next += done;
        left -= done;
    }
}

static ssize_t
send_some(int fd, void *data, size_t count, int flags)
{
    return send(fd, data, count, flags | MSG_NOSIGNAL);
}

// Tell what has happened and wait for what comes next; the level of the input
static int
report(int kind, int pin)
{
    struct report r = { kind, pin, num_events, num_said, now, alarm_ns };
    move_all(send_some, &r, sizeof(r));
    move_all(send_some, events, num_events * sizeof(*events));
    move_all(send_some, said, num_said);
    num_events = num_said = 0;
    struct answer a;
    move_all(recv, &a, sizeof(a));
    if (num_heard + a.num_bytes > MAX_BYTES)
        fail("too many bytes for the console");
    move_all(recv, heard + num_heard, a.num_bytes);
    num_heard += a.num_bytes;
    if (a.now > now)
        now = a.now;
    until = a.until;
    return a.level;
}

__attribute__((constructor)) static void
begin(void)
{
    const char *fd = getenv("FIRMWARE_FD");
    if (!fd)
        return;
    // A simulator that is killed takes the process with it
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    channel = atoi(fd);
    // The program starts itself anew when it is reset
    report(STARTED, 0);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

/****************************************************************
 * Time
 ****************************************************************/

static int64_t
to_ns(const struct timespec *ts)
{
    return (int64_t)ts->tv_sec * 1000000000 + ts->tv_nsec;
}

static int
ring_if_due(void)
{
    if (alarm_ns > now)
        return 0;
    alarm_ns = NEVER;
    on_alarm(SIGALRM);
    return 1;
}

int
clock_gettime(clockid_t id, struct timespec *ts)
{
    if (channel < 0 || id != CLOCK_MONOTONIC)
        return REAL(clock_gettime)(id, ts);
    now += TICK_NS;
    ts->tv_sec = now / 1000000000;
    ts->tv_nsec = now % 1000000000;
    ring_if_due();
    return 0;
}

int
timer_create(clockid_t id, struct sigevent *restrict event
             , timer_t *restrict timer)
{
    if (id != CLOCK_MONOTONIC || event)
        fail("only one timer, with its signal");
    *timer = 0;
    return 0;
}

int
timer_settime(timer_t timer, int flags, const struct itimerspec *restrict value
              , struct itimerspec *restrict old)
{
    (void)timer;
    if (!(flags & TIMER_ABSTIME) || old)
        fail("only absolute times");
    alarm_ns = to_ns(&value->it_value);
    ring_if_due();
    return 0;
}

int
sigaction(int number, const struct sigaction *restrict action
          , struct sigaction *restrict old)
{
    if (channel < 0 || number != SIGALRM || !action)
        return REAL(sigaction)(number, action, old);
    on_alarm = action->sa_handler;
    return 0;
}

int
ppoll(struct pollfd *fds, nfds_t nfds, const struct timespec *ts
      , const sigset_t *mask)
{
    if (channel < 0)
        return REAL(ppoll)(fds, nfds, ts, mask);
    for (;;) {
        if (ring_if_due()) {
            errno = EINTR;
            return -1;
        }
        if (num_heard) {
            fds->revents = POLLIN;
            return 1;
        }
        if (!num_said && alarm_ns <= until)
            now = alarm_ns;
        else
            report(ASLEEP, 0);
    }
}

/****************************************************************
 * The console
 ****************************************************************/

int
openpty(int *master, int *slave, char *name, const struct termios *mode
        , const struct winsize *size)
{
    int ret = REAL(openpty)(master, slave, name, mode, size);
    if (!ret && channel >= 0)
        console = *master;
    return ret;
}

ssize_t
read(int fd, void *data, size_t count)
{
    if (channel < 0 || fd != console)
        return REAL(read)(fd, data, count);
    if (!num_heard) {
        errno = EWOULDBLOCK;
        return -1;
    }
    int taken = num_heard < (int)count ? num_heard : (int)count;
    memcpy(data, heard, taken);
    num_heard -= taken;
    memmove(heard, heard + taken, num_heard);
    return taken;
}

ssize_t
__read_chk(int fd, void *data, size_t count, size_t size)
{
    (void)size;
    return read(fd, data, count);
}

ssize_t
write(int fd, const void *data, size_t count)
{
    if (channel < 0 || fd != console)
        return REAL(write)(fd, data, count);
    if (num_said + count > MAX_BYTES)
        fail("too many bytes from the console");
    memcpy(said + num_said, data, count);
    num_said += count;
    return count;
}

/****************************************************************
 * GPIO lines
 ****************************************************************/

static int
chip_number(const char *path)
{
    int number = -1;
    if (channel < 0 || sscanf(path, "/dev/gpiochip%d", &number) != 1)
        return -1;
    return number;
}

// A descriptor that stands for a chip or a line
static int
stand_in(int32_t what)
{
    int fd = REAL(open)("/dev/null", O_RDWR | O_CLOEXEC);
    if (fd < 0 || fd >= MAX_FDS)
        fail("too many lines");
    opened[fd] = what;
    return fd;
}

int
access(const char *path, int mode)
{
    return chip_number(path) < 0 ? REAL(access)(path, mode) : 0;
}

int
open(const char *path, int flags, ...)
{
    int chip = chip_number(path);
    if (chip >= 0)
        return stand_in(-1 - chip);
    va_list args;
    va_start(args, flags);
    mode_t mode = va_arg(args, mode_t);
    va_end(args);
    return REAL(open)(path, flags, mode);
}

int
close(int fd)
{
    if (fd >= 0 && fd < MAX_FDS)
        opened[fd] = 0;
    return REAL(close)(fd);
}

static void
set_line(int pin, int level)
{
    if (num_events == MAX_EVENTS)
        report(FULL, 0);
    events[num_events++] = now << 13 | pin << 1 | !!level;
}

static int
request_line(int chip, uint32_t offset, int is_output, int level)
{
    int pin = chip * CHIP_LINES + offset;
    if (is_output)
        set_line(pin, level);
    return stand_in(1 + pin);
}

static int
chip_ioctl(int chip, unsigned long request, void *arg)
{
    if (request == GPIO_GET_LINEHANDLE_IOCTL) {
        struct gpiohandle_request *r = arg;
        r->fd = request_line(chip, r->lineoffsets[0]
                             , r->flags & GPIOHANDLE_REQUEST_OUTPUT
                             , r->default_values[0]);
        return 0;
    }
#ifdef GPIO_V2_GET_LINE_IOCTL
    if (request == GPIO_V2_GET_LINE_IOCTL) {
        struct gpio_v2_line_request *r = arg;
        int level = 0;
        for (uint32_t i = 0; i < r->config.num_attrs; i++)
            if (r->config.attrs[i].attr.id
                == GPIO_V2_LINE_ATTR_ID_OUTPUT_VALUES)
                level = r->config.attrs[i].attr.values & 1;
        r->fd = request_line(chip, r->offsets[0]
                             , !!(r->config.flags & GPIO_V2_LINE_FLAG_OUTPUT)
                             , level);
        return 0;
    }
#endif
    errno = EINVAL;
    return -1;
}

static int
line_ioctl(int pin, unsigned long request, void *arg)
{
    switch (request) {
    case GPIOHANDLE_SET_LINE_VALUES_IOCTL:
        set_line(pin, ((struct gpiohandle_data *)arg)->values[0]);
        return 0;
    case GPIOHANDLE_GET_LINE_VALUES_IOCTL:
        ((struct gpiohandle_data *)arg)->values[0] = report(LOOKS, pin);
        return 0;
#ifdef GPIO_V2_LINE_SET_VALUES_IOCTL
    case GPIO_V2_LINE_SET_VALUES_IOCTL:
        set_line(pin, ((struct gpio_v2_line_values *)arg)->bits & 1);
        return 0;
    case GPIO_V2_LINE_GET_VALUES_IOCTL:
        ((struct gpio_v2_line_values *)arg)->bits = report(LOOKS, pin);
        return 0;
#endif
    }
    errno = EINVAL;
    return -1;
}

int
ioctl(int fd, unsigned long request, ...)
{
    va_list args;
    va_start(args, request);
    void *arg = va_arg(args, void *);
    va_end(args);
    int32_t what = fd >= 0 && fd < MAX_FDS ? opened[fd] : 0;
    if (what < 0)
        return chip_ioctl(-1 - what, request, arg);
    if (what > 0)
        return line_ioctl(what - 1, request, arg);
    return REAL(ioctl)(fd, request, arg);
}
