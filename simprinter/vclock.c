// A virtual clock for one process, preloaded into it (LD_PRELOAD).
//
// The process reads its time from a page of memory it shares with the
// simulator, which owns the clock. Every wait that could end by time or by
// another thread is taken over: the thread publishes when it wants to be woken
// and sleeps; nobody's sleep ends because real time passes. The simulator may
// move the clock only while `awake` is 0, that is while every thread of the
// process is asleep in one of the waits below and none of them has a file
// descriptor ready.
//
// What keeps `awake` honest:
// - A thread that wakes another (semaphore, condition, thread creation) counts
//   it as awake at once, on its behalf, before it can fall asleep itself.
// - The last thread to fall asleep looks at the file descriptors all others
//   wait for (a pipe written by one thread and polled by another) and counts
//   the owners of ready ones as awake.
// - Data that comes from outside is the simulator's own and known to it: bytes
//   on a serial line are counted here as they are read and written.
// - Everything else that can block (mutexes, timed condition waits, reading a
//   file) counts as awake; time stands still meanwhile.
//
// Child processes live in real time. They are no threads of the process, so
// they do not count as awake: they are listed in the page, and the simulator
// lets the clock go no faster than they live. It sees by itself when one has
// ended; the output that this one left behind is then looked at by those who
// wait for it, before the clock moves on.
//
// pthread_cond_timedwait is left in real time on purpose: Python uses it for
// nothing but its interpreter lock, whose holder is awake by the rules above.
//
// 64-bit glibc only (see LIMITS.md).
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <pthread.h>
#include <semaphore.h>
#include <signal.h>
#include <spawn.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/select.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#define PAGE_MAGIC 0x76636c6b
#define MAX_THREADS 64
#define MAX_TTYS 8
#define MAX_CHILDREN 64
#define NEVER INT64_MAX
// A thread that has read the same instant this often is spinning until the
// clock moves: it then moves by SPIN_NS.
#define SPIN_READS 1000
#define SPIN_NS 1000

struct slot {
    int32_t used, asleep;
    int64_t deadline;           // virtual ns
    int32_t nfds, pad;
    struct pollfd *fds;         // valid while asleep (the owner's stack)
    void *key;                  // semaphore or condition waited for
};

struct tty {
    int64_t bytes_read, bytes_written;
    int32_t major, minor, is_open, pad;
};

struct page {
    uint32_t magic;
    _Atomic int32_t awake;
    _Atomic int64_t wakes;      // how often a thread has woken, ever
    _Atomic int64_t now;        // virtual CLOCK_MONOTONIC, ns
    pthread_mutex_t lock;       // of the slots, shared with the simulator
    _Atomic int32_t joined;     // the process lives on this clock
    int64_t wall_offset;        // virtual CLOCK_REALTIME - now, ns
    int32_t doorbell;           // rung when the last thread falls asleep
    int32_t num_ttys;
    _Atomic int32_t started;    // children, ever
    int64_t children[MAX_CHILDREN]; // number of start << 32 | pid; 0: none
    int32_t wake_fds[MAX_THREADS];
    struct tty ttys[MAX_TTYS];
    struct slot slots[MAX_THREADS];
};

/****************************************************************
 * The simulator's side (called through ctypes)
 ****************************************************************/

size_t
vclock_page_size(void)
{
    return sizeof(struct page);
}

int
vclock_max_threads(void)
{
    return MAX_THREADS;
}

void
vclock_init(struct page *p, int64_t now, int64_t wall, int doorbell
            , const int32_t *wake_fds)
{
    memset(p, 0, sizeof(*p));
    p->now = now;
    p->wall_offset = wall - now;
    p->doorbell = doorbell;
    memcpy(p->wake_fds, wake_fds, sizeof(p->wake_fds));
    pthread_mutexattr_t attr;
    pthread_mutexattr_init(&attr);
    pthread_mutexattr_setpshared(&attr, PTHREAD_PROCESS_SHARED);
    // The process may be killed at any moment
    pthread_mutexattr_setrobust(&attr, PTHREAD_MUTEX_ROBUST);
    pthread_mutex_init(&p->lock, &attr);
    p->awake = 1; // the main thread, before it has started
    p->magic = PAGE_MAGIC;
}

int
vclock_add_tty(struct page *p, int32_t major_num, int32_t minor_num)
{
    if (p->num_ttys >= MAX_TTYS)
        return -1;
    p->ttys[p->num_ttys].major = major_num;
    p->ttys[p->num_ttys].minor = minor_num;
    return p->num_ttys++;
}

int32_t
vclock_awake(struct page *p)
{
    return p->awake;
}

// 0 until the process lives on this clock
_Atomic int32_t *
vclock_joined_field(struct page *p)
{
    return &p->joined;
}

// Where the clock stands, to be read without a call
_Atomic int64_t *
vclock_now_field(struct page *p)
{
    return &p->now;
}

// Where the bytes are counted that the process has written to a line
int64_t *
vclock_written_field(struct page *p, int tty)
{
    return &p->ttys[tty].bytes_written;
}

// Whether all bytes of a line have arrived. Nobody reads a line that is closed
// before it is opened again
int
vclock_tty_settled(struct page *p, int tty, int64_t sent, int64_t received)
{
    struct tty *t = &p->ttys[tty];
    return (t->bytes_written == received
            && (!t->is_open || t->bytes_read == sent));
}

// Whether the process has a line open, and has read or written there since
int
vclock_tty_is_open(struct page *p, int tty)
{
    return p->ttys[tty].is_open;
}

// Earliest deadline of a sleeping thread (only meaningful while awake is 0)
int64_t
vclock_next_deadline(struct page *p)
{
    int64_t next = NEVER;
    for (int i = 0; i < MAX_THREADS; i++) {
        struct slot *s = &p->slots[i];
        if (s->used && s->asleep && s->deadline < next)
            next = s->deadline;
    }
    return next;
}

static ssize_t (*real_write)(int, const void *, size_t);
static void find_symbols(void);

static void
ring(int fd)
{
    uint64_t one = 1;
    find_symbols();
    ssize_t ret = real_write(fd, &one, sizeof(one));
    (void)ret; // an eventfd that is already set needs no second ring
}

static void
lock_slots(struct page *p)
{
    if (pthread_mutex_lock(&p->lock) == EOWNERDEAD)
        pthread_mutex_consistent(&p->lock);
}

static void
unlock_slots(struct page *p)
{
    pthread_mutex_unlock(&p->lock);
}

// Count a sleeping thread as awake and make sure it wakes
static void
rouse(struct page *p, int i)
{
    p->slots[i].asleep = 0;
    atomic_fetch_add(&p->awake, 1);
    atomic_fetch_add(&p->wakes, 1);
    ring(p->wake_fds[i]);
}

int64_t
vclock_wakes(struct page *p)
{
    return p->wakes;
}

// How many children the process has started, to be read without a call
_Atomic int32_t *
vclock_started_field(struct page *p)
{
    return &p->started;
}

int
vclock_max_children(void)
{
    return MAX_CHILDREN;
}

// Children that have been started, ended ones perhaps among them
void
vclock_children(struct page *p, int64_t *children)
{
    lock_slots(p);
    memcpy(children, p->children, sizeof(p->children));
    unlock_slots(p);
}

// Have all who wait for descriptors look at them again
void
vclock_look_again(struct page *p)
{
    lock_slots(p);
    for (int i = 0; i < MAX_THREADS; i++) {
        struct slot *s = &p->slots[i];
        if (s->used && s->asleep && s->nfds)
            rouse(p, i);
    }
    unlock_slots(p);
}

// Move the clock and wake every thread whose deadline has come; 0 if a thread
// is awake or has been since `wakes` was read: what the caller has seen of the
// process may then be out of date.
int
vclock_advance(struct page *p, int64_t now, int64_t wakes)
{
    lock_slots(p);
    int still = !p->awake && p->wakes == wakes;
    if (still)
        p->now = now;
    for (int i = 0; still && i < MAX_THREADS; i++) {
        struct slot *s = &p->slots[i];
        if (s->used && s->asleep && s->deadline <= now)
            rouse(p, i);
    }
    unlock_slots(p);
    return still;
}

/****************************************************************
 * The process's side
 ****************************************************************/

static struct page *page;
static pthread_key_t exit_key;
static __thread int my_slot = -1;
static __thread int64_t last_read;
static __thread int same_reads;

static int (*real_clock_gettime)(clockid_t, struct timespec *);
static int (*real_ppoll)(struct pollfd *, nfds_t, const struct timespec *
                         , const sigset_t *);
static int (*real_epoll_wait)(int, struct epoll_event *, int, int);
static int (*real_select)(int, fd_set *, fd_set *, fd_set *
                          , struct timeval *);
static int (*real_clock_nanosleep)(clockid_t, int, const struct timespec *
                                   , struct timespec *);
static int (*real_sem_wait)(sem_t *);
static int (*real_sem_trywait)(sem_t *);
static int (*real_sem_clockwait)(sem_t *, clockid_t, const struct timespec *);
static int (*real_sem_timedwait)(sem_t *, const struct timespec *);
static int (*real_sem_post)(sem_t *);
static int (*real_cond_wait)(pthread_cond_t *, pthread_mutex_t *);
static int (*real_cond_clockwait)(pthread_cond_t *, pthread_mutex_t *
                                  , clockid_t, const struct timespec *);
static int (*real_cond_timedwait)(pthread_cond_t *, pthread_mutex_t *
                                  , const struct timespec *);
static int (*real_cond_signal)(pthread_cond_t *);
static int (*real_cond_broadcast)(pthread_cond_t *);
static int (*real_create)(pthread_t *, const pthread_attr_t *
                          , void *(*)(void *), void *);
static ssize_t (*real_read)(int, void *, size_t);
static int (*real_spawn)(pid_t *, const char *
                         , const posix_spawn_file_actions_t *
                         , const posix_spawnattr_t *, char *const *
                         , char *const *);
static int (*real_spawnp)(pid_t *, const char *
                          , const posix_spawn_file_actions_t *
                          , const posix_spawnattr_t *, char *const *
                          , char *const *);
static pid_t (*real_fork)(void);
static pid_t (*real_waitpid)(pid_t, int *, int);
static int (*real_close)(int);

// Conditions have an older version of their symbols on x86_64, which dlsym
// would return
static void *
cond_symbol(const char *name)
{
    void *sym = dlvsym(RTLD_NEXT, name, "GLIBC_2.3.2");
    return sym ? sym : dlsym(RTLD_NEXT, name);
}

static void
find_symbols(void)
{
    if (real_close)
        return;
    real_clock_gettime = dlsym(RTLD_NEXT, "clock_gettime");
    real_ppoll = dlsym(RTLD_NEXT, "ppoll");
    real_epoll_wait = dlsym(RTLD_NEXT, "epoll_wait");
    real_select = dlsym(RTLD_NEXT, "select");
    real_clock_nanosleep = dlsym(RTLD_NEXT, "clock_nanosleep");
    real_sem_wait = dlsym(RTLD_NEXT, "sem_wait");
    real_sem_trywait = dlsym(RTLD_NEXT, "sem_trywait");
    real_sem_clockwait = dlsym(RTLD_NEXT, "sem_clockwait");
    real_sem_timedwait = dlsym(RTLD_NEXT, "sem_timedwait");
    real_sem_post = dlsym(RTLD_NEXT, "sem_post");
    real_cond_wait = cond_symbol("pthread_cond_wait");
    real_cond_clockwait = dlsym(RTLD_NEXT, "pthread_cond_clockwait");
    real_cond_timedwait = cond_symbol("pthread_cond_timedwait");
    real_cond_signal = cond_symbol("pthread_cond_signal");
    real_cond_broadcast = cond_symbol("pthread_cond_broadcast");
    real_create = dlsym(RTLD_NEXT, "pthread_create");
    real_read = dlsym(RTLD_NEXT, "read");
    real_write = dlsym(RTLD_NEXT, "write");
    real_spawn = dlsym(RTLD_NEXT, "posix_spawn");
    real_spawnp = dlsym(RTLD_NEXT, "posix_spawnp");
    real_fork = dlsym(RTLD_NEXT, "fork");
    real_waitpid = dlsym(RTLD_NEXT, "waitpid");
    real_close = dlsym(RTLD_NEXT, "close");
}

static int64_t
to_ns(const struct timespec *ts)
{
    return (int64_t)ts->tv_sec * 1000000000 + ts->tv_nsec;
}

static struct timespec
to_timespec(int64_t ns)
{
    struct timespec ts = { ns / 1000000000, ns % 1000000000 };
    return ts;
}

static int64_t
deadline_in(int64_t ns)
{
    return ns < 0 ? NEVER : page->now + ns;
}

// The clock as a thread reads it
static int64_t
read_clock(void)
{
    int64_t now = page->now;
    if (now != last_read) {
        last_read = now;
        same_reads = 0;
    } else if (++same_reads > SPIN_READS) {
        atomic_fetch_add(&page->now, SPIN_NS);
    }
    return now;
}

/****************************************************************
 * Sleeping and waking (all below with the slots locked unless said)
 ****************************************************************/

static void
wake_key(void *key)
{
    for (int i = 0; i < MAX_THREADS; i++) {
        struct slot *s = &page->slots[i];
        if (s->used && s->asleep && s->key == key)
            rouse(page, i);
    }
}

static void
wake_ready_fds(void)
{
    struct timespec zero = { 0, 0 };
    for (int i = 0; i < MAX_THREADS; i++) {
        struct slot *s = &page->slots[i];
        if (s->used && s->asleep && s->nfds
            && real_ppoll(s->fds, s->nfds, &zero, NULL) > 0)
            rouse(page, i);
    }
}

// One thread less is awake; tell the simulator if it was the last
static void
drop_awake(void)
{
    if (atomic_fetch_sub(&page->awake, 1) != 1)
        return;
    wake_ready_fds();
    if (page->awake)
        return;
    ring(page->doorbell);
}

static void
fall_asleep(int64_t deadline, struct pollfd *fds, int nfds, void *key)
{
    struct slot *s = &page->slots[my_slot];
    s->deadline = deadline;
    s->fds = fds;
    s->nfds = nfds;
    s->key = key;
    s->asleep = 1;
    drop_awake();
}

// Block (slots not locked) until something woke this thread. The last entry of
// fds is the thread's own wake descriptor.
static int
block(struct pollfd *fds, int nfds)
{
    int ret = real_ppoll(fds, nfds + 1, NULL, NULL);
    int err = errno;
    lock_slots(page);
    struct slot *s = &page->slots[my_slot];
    if (s->asleep) {
        s->asleep = 0;
        atomic_fetch_add(&page->awake, 1);
        atomic_fetch_add(&page->wakes, 1);
    } else {
        // Whoever counted us as awake has rung, perhaps after the poll ended
        uint64_t count;
        ssize_t got = real_read(page->wake_fds[my_slot], &count
                                , sizeof(count));
        (void)got;
    }
    s->nfds = 0;
    s->key = NULL;
    unlock_slots(page);
    errno = err;
    return ret;
}

// Sleep until a deadline or until one of fds is ready. fds needs room for one
// more entry. Returns like poll().
static int
sleep_fds(int64_t deadline, struct pollfd *fds, int nfds)
{
    struct timespec zero = { 0, 0 };
    for (;;) {
        int ret = real_ppoll(fds, nfds, &zero, NULL);
        if (ret || deadline <= page->now)
            return ret;
        // What the last sleeper looks at must not be written by our own poll
        struct pollfd watch[nfds + 1];
        memcpy(watch, fds, nfds * sizeof(*fds));
        fds[nfds].fd = page->wake_fds[my_slot];
        fds[nfds].events = POLLIN;
        lock_slots(page);
        fall_asleep(deadline, watch, nfds, NULL);
        unlock_slots(page);
        if (block(fds, nfds) < 0)
            return -1;
    }
}

/****************************************************************
 * Threads
 ****************************************************************/

static int
claim_slot(void)
{
    lock_slots(page);
    for (int i = 0; i < MAX_THREADS; i++) {
        if (page->slots[i].used)
            continue;
        memset(&page->slots[i], 0, sizeof(page->slots[i]));
        page->slots[i].used = 1;
        unlock_slots(page);
        return i;
    }
    fprintf(stderr, "vclock: more than %d threads\n", MAX_THREADS);
    abort();
}

static void
thread_exit(void *unused)
{
    (void)unused;
    lock_slots(page);
    page->slots[my_slot].used = 0;
    my_slot = -1;
    drop_awake();
    unlock_slots(page);
}

struct start {
    void *(*func)(void *);
    void *arg;
};

static void *
thread_start(void *data)
{
    struct start s = *(struct start *)data;
    free(data);
    my_slot = claim_slot();
    pthread_setspecific(exit_key, &exit_key); // any value: runs thread_exit
    return s.func(s.arg);
}

int
pthread_create(pthread_t *tid, const pthread_attr_t *attr
               , void *(*func)(void *), void *arg)
{
    find_symbols();
    if (!page)
        return real_create(tid, attr, func, arg);
    struct start *s = malloc(sizeof(*s));
    s->func = func;
    s->arg = arg;
    atomic_fetch_add(&page->awake, 1);
    int ret = real_create(tid, attr, thread_start, s);
    if (ret) {
        free(s);
        lock_slots(page);
        drop_awake();
        unlock_slots(page);
    }
    return ret;
}

/****************************************************************
 * Children
 ****************************************************************/

// A forked child shares the page but is no part of the simulation
static void
leave_simulation(void)
{
    page = NULL;
    my_slot = -1;
}

static int
is_child_gone(pid_t pid)
{
    siginfo_t info = { .si_pid = 0 };
    // Leaves it to be waited for; fails where somebody has done so
    return waitid(P_PID, pid, &info, WEXITED | WNOHANG | WNOWAIT)
        || info.si_pid;
}

// Called by a thread that is awake: the clock has not moved since the start
static void
add_child(pid_t pid)
{
    if (!page)
        return;
    lock_slots(page);
    int64_t number = ++page->started, *place = NULL;
    for (int i = 0; i < MAX_CHILDREN; i++) {
        int64_t *child = &page->children[i];
        if (*child && is_child_gone((pid_t)*child))
            *child = 0;
        if (!*child && !place)
            place = child;
    }
    if (!place) {
        fprintf(stderr, "vclock: more than %d children\n", MAX_CHILDREN);
        kill(pid, SIGKILL); // nobody else knows it
        abort();
    }
    *place = number << 32 | pid;
    unlock_slots(page);
}

pid_t
fork(void)
{
    find_symbols();
    pid_t pid = real_fork();
    int err = errno;
    if (pid > 0)
        add_child(pid);
    errno = err;
    return pid;
}

// A child that shares our memory until it executes a program would leave the
// simulation for us too
pid_t
vfork(void)
{
    return fork();
}

int
posix_spawn(pid_t *restrict pid, const char *restrict path
            , const posix_spawn_file_actions_t *restrict actions
            , const posix_spawnattr_t *restrict attr
            , char *const argv[restrict], char *const envp[restrict])
{
    find_symbols();
    pid_t child;
    int ret = real_spawn(&child, path, actions, attr, argv, envp);
    if (ret)
        return ret;
    add_child(child);
    if (pid)
        *pid = child;
    return 0;
}

int
posix_spawnp(pid_t *restrict pid, const char *restrict file
             , const posix_spawn_file_actions_t *restrict actions
             , const posix_spawnattr_t *restrict attr
             , char *const argv[restrict], char *const envp[restrict])
{
    find_symbols();
    pid_t child;
    int ret = real_spawnp(&child, file, actions, attr, argv, envp);
    if (ret)
        return ret;
    add_child(child);
    if (pid)
        *pid = child;
    return 0;
}

// Live on the clock at this path from now on. Called when the library is
// loaded, or later by a process that was forked to become part of a simulation
void
vclock_join(const char *path)
{
    int fd = open(path, O_RDWR | O_CLOEXEC);
    if (fd < 0) {
        perror("vclock: VCLOCK_PAGE");
        abort();
    }
    void *map = mmap(NULL, sizeof(struct page), PROT_READ | PROT_WRITE
                     , MAP_SHARED, fd, 0);
    real_close(fd);
    if (map == MAP_FAILED || ((struct page *)map)->magic != PAGE_MAGIC) {
        fprintf(stderr, "vclock: %s is no clock page\n", path);
        abort();
    }
    // Programs this one starts run in real time
    unsetenv("LD_PRELOAD");
    unsetenv("VCLOCK_PAGE");
    // A simulator that is killed takes the process with it
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    page = map;
    page->joined = 1;
    pthread_key_create(&exit_key, thread_exit);
    pthread_atfork(NULL, NULL, leave_simulation);
    my_slot = claim_slot();
}

__attribute__((constructor)) static void
join_at_start(void)
{
    find_symbols();
    const char *path = getenv("VCLOCK_PAGE");
    if (path)
        vclock_join(path);
}

// Whether this thread takes part
static int
takes_part(void)
{
    find_symbols();
    return page && my_slot >= 0;
}

/****************************************************************
 * Reading the clock
 ****************************************************************/

static int
is_wall(clockid_t id)
{
    return id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE;
}

static int
is_monotonic(clockid_t id)
{
    return (id == CLOCK_MONOTONIC || id == CLOCK_MONOTONIC_RAW
            || id == CLOCK_MONOTONIC_COARSE || id == CLOCK_BOOTTIME);
}

int
clock_gettime(clockid_t id, struct timespec *ts)
{
    if (!takes_part() || !(is_wall(id) || is_monotonic(id)))
        return real_clock_gettime(id, ts);
    *ts = to_timespec(read_clock() + (is_wall(id) ? page->wall_offset : 0));
    return 0;
}

int
gettimeofday(struct timeval *restrict tv, void *restrict tz)
{
    (void)tz;
    struct timespec ts;
    int ret = clock_gettime(CLOCK_REALTIME, &ts);
    tv->tv_sec = ts.tv_sec;
    tv->tv_usec = ts.tv_nsec / 1000;
    return ret;
}

time_t
time(time_t *out)
{
    struct timespec ts;
    clock_gettime(CLOCK_REALTIME, &ts);
    if (out)
        *out = ts.tv_sec;
    return ts.tv_sec;
}

/****************************************************************
 * Waiting for descriptors and for time
 ****************************************************************/

int
poll(struct pollfd *fds, nfds_t nfds, int timeout)
{
    if (!takes_part() || !timeout) {
        struct timespec ts = to_timespec((int64_t)timeout * 1000000);
        find_symbols();
        return real_ppoll(fds, nfds, timeout < 0 ? NULL : &ts, NULL);
    }
    struct pollfd copy[nfds + 1];
    memcpy(copy, fds, nfds * sizeof(*fds));
    int64_t wait = timeout < 0 ? -1 : (int64_t)timeout * 1000000;
    int ret = sleep_fds(deadline_in(wait), copy, nfds);
    memcpy(fds, copy, nfds * sizeof(*fds));
    return ret;
}

int
__poll_chk(struct pollfd *fds, nfds_t nfds, int timeout, size_t fdslen)
{
    (void)fdslen;
    return poll(fds, nfds, timeout);
}

int
ppoll(struct pollfd *fds, nfds_t nfds, const struct timespec *ts
      , const sigset_t *mask)
{
    if (!takes_part() || mask || (ts && !to_ns(ts)))
        return real_ppoll(fds, nfds, ts, mask);
    struct pollfd copy[nfds + 1];
    memcpy(copy, fds, nfds * sizeof(*fds));
    int ret = sleep_fds(deadline_in(ts ? to_ns(ts) : -1), copy, nfds);
    memcpy(fds, copy, nfds * sizeof(*fds));
    return ret;
}

int
epoll_wait(int epfd, struct epoll_event *events, int max, int timeout)
{
    if (!takes_part() || !timeout)
        return real_epoll_wait(epfd, events, max, timeout);
    int64_t deadline = deadline_in(timeout < 0 ? -1
                                   : (int64_t)timeout * 1000000);
    struct pollfd fds[2] = { { .fd = epfd, .events = POLLIN } };
    int ret = sleep_fds(deadline, fds, 1);
    return ret <= 0 ? ret : real_epoll_wait(epfd, events, max, 0);
}

int
select(int nfds, fd_set *rd, fd_set *wr, fd_set *ex, struct timeval *tv)
{
    int64_t wait = -1;
    if (tv)
        wait = (int64_t)tv->tv_sec * 1000000000 + tv->tv_usec * 1000;
    if (!takes_part() || !wait)
        return real_select(nfds, rd, wr, ex, tv);
    struct pollfd fds[nfds + 1];
    int count = 0;
    for (int fd = 0; fd < nfds; fd++) {
        short events = ((rd && FD_ISSET(fd, rd) ? POLLIN : 0)
                        | (wr && FD_ISSET(fd, wr) ? POLLOUT : 0)
                        | (ex && FD_ISSET(fd, ex) ? POLLPRI : 0));
        if (events)
            fds[count++] = (struct pollfd){ .fd = fd, .events = events };
    }
    if (sleep_fds(deadline_in(wait), fds, count) < 0)
        return -1;
    struct timeval zero = { 0, 0 };
    return real_select(nfds, rd, wr, ex, &zero);
}

int
clock_nanosleep(clockid_t id, int flags, const struct timespec *req
                , struct timespec *rem)
{
    if (!takes_part() || !(is_wall(id) || is_monotonic(id)))
        return real_clock_nanosleep(id, flags, req, rem);
    int64_t deadline = to_ns(req);
    if (!(flags & TIMER_ABSTIME))
        deadline += page->now;
    else if (is_wall(id))
        deadline -= page->wall_offset;
    struct pollfd fds[1];
    if (sleep_fds(deadline, fds, 0) < 0) {
        if (rem && !(flags & TIMER_ABSTIME))
            *rem = to_timespec(deadline - page->now);
        return errno;
    }
    return 0;
}

int
nanosleep(const struct timespec *req, struct timespec *rem)
{
    int err = clock_nanosleep(CLOCK_MONOTONIC, 0, req, rem);
    if (!err)
        return 0;
    errno = err;
    return -1;
}

// Waiting for a child is waiting for a descriptor
pid_t
waitpid(pid_t pid, int *status, int options)
{
    if (!takes_part() || pid <= 0 || options & WNOHANG)
        return real_waitpid(pid, status, options);
    struct pollfd fds[2] = { { .events = POLLIN } };
    fds[0].fd = syscall(SYS_pidfd_open, pid, 0);
    if (fds[0].fd >= 0) {
        int ret = sleep_fds(NEVER, fds, 1);
        int err = errno;
        real_close(fds[0].fd);
        errno = err;
        if (ret < 0)
            return -1;
    }
    return real_waitpid(pid, status, options);
}

int
usleep(useconds_t usec)
{
    struct timespec ts = to_timespec((int64_t)usec * 1000);
    return nanosleep(&ts, NULL);
}

/****************************************************************
 * Waiting for another thread
 ****************************************************************/

// Wait for a semaphore until a deadline; 0, or -1 with errno
static int
sleep_sem(sem_t *sem, int64_t deadline)
{
    struct pollfd fds[1];
    for (;;) {
        lock_slots(page);
        // A post is made before it looks for sleepers, so that one of the two
        // sees the other
        if (!real_sem_trywait(sem)) {
            unlock_slots(page);
            return 0;
        }
        if (errno != EAGAIN || deadline <= page->now) {
            if (errno == EAGAIN)
                errno = ETIMEDOUT;
            unlock_slots(page);
            return -1;
        }
        fds[0] = (struct pollfd){ .fd = page->wake_fds[my_slot]
                                  , .events = POLLIN };
        fall_asleep(deadline, NULL, 0, sem);
        unlock_slots(page);
        if (block(fds, 0) < 0)
            return -1;
    }
}

int
sem_wait(sem_t *sem)
{
    return takes_part() ? sleep_sem(sem, NEVER) : real_sem_wait(sem);
}

int
sem_clockwait(sem_t *sem, clockid_t id, const struct timespec *ts)
{
    if (!takes_part())
        return real_sem_clockwait(sem, id, ts);
    return sleep_sem(sem, to_ns(ts) - (is_wall(id) ? page->wall_offset : 0));
}

int
sem_timedwait(sem_t *sem, const struct timespec *ts)
{
    if (!takes_part())
        return real_sem_timedwait(sem, ts);
    return sleep_sem(sem, to_ns(ts) - page->wall_offset);
}

int
sem_post(sem_t *sem)
{
    find_symbols();
    int ret = real_sem_post(sem);
    if (!page)
        return ret;
    lock_slots(page);
    wake_key(sem);
    unlock_slots(page);
    return ret;
}

int
pthread_cond_wait(pthread_cond_t *cond, pthread_mutex_t *mutex)
{
    if (!takes_part())
        return real_cond_wait(cond, mutex);
    struct pollfd fds[1] = { { .fd = page->wake_fds[my_slot]
                               , .events = POLLIN } };
    lock_slots(page);
    fall_asleep(NEVER, NULL, 0, cond);
    unlock_slots(page);
    pthread_mutex_unlock(mutex);
    block(fds, 0);
    pthread_mutex_lock(mutex);
    return 0;
}

// The interpreter lock's wait: in real time, but its absolute end was computed
// from the virtual clock
int
pthread_cond_clockwait(pthread_cond_t *cond, pthread_mutex_t *mutex
                       , clockid_t id, const struct timespec *ts)
{
    if (!takes_part())
        return real_cond_clockwait(cond, mutex, id, ts);
    int64_t left = to_ns(ts) - page->now;
    if (left > page->wall_offset / 2) // a wall clock time
        left -= page->wall_offset;
    struct timespec end;
    real_clock_gettime(CLOCK_MONOTONIC, &end);
    end = to_timespec(to_ns(&end) + (left > 0 ? left : 0));
    return real_cond_clockwait(cond, mutex, CLOCK_MONOTONIC, &end);
}

int
pthread_cond_timedwait(pthread_cond_t *cond, pthread_mutex_t *mutex
                       , const struct timespec *ts)
{
    if (!takes_part())
        return real_cond_timedwait(cond, mutex, ts);
    return pthread_cond_clockwait(cond, mutex, CLOCK_MONOTONIC, ts);
}

int
pthread_cond_signal(pthread_cond_t *cond)
{
    find_symbols();
    if (page) {
        // All of them: a condition may wake without reason, never too few
        lock_slots(page);
        wake_key(cond);
        unlock_slots(page);
    }
    return real_cond_signal(cond);
}

int
pthread_cond_broadcast(pthread_cond_t *cond)
{
    find_symbols();
    if (page) {
        lock_slots(page);
        wake_key(cond);
        unlock_slots(page);
    }
    return real_cond_broadcast(cond);
}

/****************************************************************
 * Reading and writing
 ****************************************************************/

static struct tty *
tty_with(const struct stat *st)
{
    if (!S_ISCHR(st->st_mode))
        return NULL;
    int32_t major_num = (st->st_rdev >> 8) & 0xfff;
    int32_t minor_num = (st->st_rdev & 0xff) | ((st->st_rdev >> 12) & 0xfff00);
    for (int i = 0; i < page->num_ttys; i++) {
        struct tty *t = &page->ttys[i];
        if (t->major == major_num && t->minor == minor_num)
            return t;
    }
    return NULL;
}

static struct tty *
tty_of(int fd)
{
    struct stat st;
    return page && page->num_ttys && !fstat(fd, &st) ? tty_with(&st) : NULL;
}

// Whether to read here may take until somebody has written
static int
may_block(int fd, const struct stat *st)
{
    return (S_ISFIFO(st->st_mode) || S_ISSOCK(st->st_mode))
        && !(fcntl(fd, F_GETFL) & O_NONBLOCK);
}

ssize_t
read(int fd, void *buf, size_t count)
{
    struct stat st;
    if (!takes_part() || fstat(fd, &st))
        return real_read(fd, buf, count);
    if (may_block(fd, &st)) {
        struct pollfd fds[2] = { { .fd = fd, .events = POLLIN } };
        if (sleep_fds(NEVER, fds, 1) < 0)
            return -1;
    }
    ssize_t ret = real_read(fd, buf, count);
    int err = errno;
    struct tty *t = ret > 0 ? tty_with(&st) : NULL;
    if (t) {
        t->is_open = 1;
        t->bytes_read += ret;
    }
    errno = err;
    return ret;
}

ssize_t
__read_chk(int fd, void *buf, size_t count, size_t buflen)
{
    (void)buflen;
    return read(fd, buf, count);
}

ssize_t
write(int fd, const void *buf, size_t count)
{
    find_symbols();
    ssize_t ret = real_write(fd, buf, count);
    int err = errno;
    struct tty *t = ret > 0 ? tty_of(fd) : NULL;
    if (t) {
        t->is_open = 1;
        t->bytes_written += ret;
    }
    errno = err;
    return ret;
}

int
close(int fd)
{
    find_symbols();
    struct tty *t = tty_of(fd);
    if (t)
        t->is_open = 0;
    return real_close(fd);
}
