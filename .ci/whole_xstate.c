/*
 * Lets Debian 12's User-Mode Linux run on processors with AVX-512 or AMX.
 *
 * That kernel keeps the first 832 bytes of a thread's floating-point state (x87, SSE, AVX) and hands just these back
 * with ptrace(PTRACE_SETREGSET, NT_X86_XSTATE). Since Linux 5.15 or so the host takes the whole state or nothing, which
 * on such processors is more, and the guest's first process dies of it. Preloaded, this library stands between: what
 * is read is kept whole, by the address the guest keeps its own part at, and what is written is completed from there.
 * So the guest's threads keep their wide registers, too.
 */
#define _GNU_SOURCE
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum {
    STATES = 8192,              /* threads that can be told apart; the table is open-addressed and never shrinks */
    STATE_BYTES = 16384,        /* AMX included, a state is 11008 */
    COMPONENTS_AT = 512         /* XSTATE_BV, the set of components that are not in their initial state */
};
static const uint64_t GUESTS_COMPONENTS = 7; /* x87, SSE, AVX: what the guest keeps itself */

static const void *owners[STATES];
static unsigned char states[STATES][STATE_BYTES] __attribute__((aligned(64)));
static unsigned char current[STATE_BYTES] __attribute__((aligned(64)));

/* The kept state of the guest's buffer at `owner`; NULL when the table is full. */
static unsigned char *state_of(const void *owner)
{
    size_t first = (size_t)(((uintptr_t)owner >> 6) * UINT64_C(0x9E3779B97F4A7C15) >> 51);
    for (size_t step = 0; step < STATES; step++) {
        size_t slot = (first + step) % STATES;
        if (owners[slot] == NULL)
            owners[slot] = owner;
        if (owners[slot] == owner)
            return states[slot];
    }
    return NULL;
}

static long read_state(long pid, struct iovec *guests)
{
    unsigned char *state = state_of(guests->iov_base);
    struct iovec whole = { state == NULL ? current : state, STATE_BYTES };
    long result = syscall(SYS_ptrace, PTRACE_GETREGSET, pid, NT_X86_XSTATE, &whole);
    if (result != 0)
        return result;
    if (guests->iov_len > whole.iov_len)
        guests->iov_len = whole.iov_len;
    memcpy(guests->iov_base, whole.iov_base, guests->iov_len);
    return 0;
}

static long write_state(long pid, const struct iovec *guests)
{
    struct iovec whole = { current, STATE_BYTES };
    long result = syscall(SYS_ptrace, PTRACE_GETREGSET, pid, NT_X86_XSTATE, &whole);
    if (result != 0)
        return result;
    unsigned char *state = state_of(guests->iov_base);
    uint64_t upper = 0, lower;
    if (state != NULL)
        memcpy(&upper, state + COMPONENTS_AT, sizeof upper);
    if (upper != 0)
        whole.iov_base = state; /* else nothing was read there yet: the new thread goes on with what its process has */
    memcpy(&upper, (unsigned char *)whole.iov_base + COMPONENTS_AT, sizeof upper);
    memcpy(whole.iov_base, guests->iov_base, guests->iov_len);
    memcpy(&lower, (unsigned char *)whole.iov_base + COMPONENTS_AT, sizeof lower);
    lower = (lower & GUESTS_COMPONENTS) | (upper & ~GUESTS_COMPONENTS);
    memcpy((unsigned char *)whole.iov_base + COMPONENTS_AT, &lower, sizeof lower);
    return syscall(SYS_ptrace, PTRACE_SETREGSET, pid, NT_X86_XSTATE, &whole);
}

long ptrace(enum __ptrace_request request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    long pid = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);

    if ((uintptr_t)address == NT_X86_XSTATE) {
        if (request == PTRACE_GETREGSET)
            return read_state(pid, data);
        if (request == PTRACE_SETREGSET)
            return write_state(pid, data);
    }
    if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
        long word = 0; /* the system call writes it, the library's function returns it */
        if (syscall(SYS_ptrace, request, pid, address, &word) != 0)
            return -1;
        errno = 0;
        return word;
    }
    return syscall(SYS_ptrace, request, pid, address, data);
}
