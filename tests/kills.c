/* Preloaded into a process: counts what it does to files below a folder and kills it at a call.

   kill_at(folder, call, half): die before the call-th write, truncation, sync, rename or removal
   of a file below the folder or, with half, in the middle of the call-th write.

   fail_at(folder, call, error, on): let that call, and with on all later ones, fail with this error
   instead; removals and closing never fail.  calls(): how many there were. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/uio.h>
#include <unistd.h>

static char folder[PATH_MAX];
static long last = -1, count;
static int halves, failing, always;

void kill_at(const char *below, long call, int half)
{
    strncpy(folder, below, sizeof folder - 1);
    last = call, halves = half, count = failing = 0;
}

void fail_at(const char *below, long call, int error, int on)
{
    kill_at(below, call, 0);
    failing = error, always = on;
}

long calls(void) { return count; }

static int below(const char *path) { return *folder && strstr(path, folder) == path; }

static int below_file(int file)
{
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t size = readlink(link, path, sizeof path - 1);
    path[size < 0 ? 0 : size] = 0;
    return below(path);
}

static int due(int ours)
{
    if (!ours) return 0;
    count++;
    return count == last || (failing && always && count > last);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define WRITING(name, file, size, ...)                          \
    if (due(below_file(file))) {                                \
        if (failing) { errno = failing; return -1; }            \
        if (halves) { size_t half = (size) / 2; (void)!REAL(name)(__VA_ARGS__); } \
        raise(SIGKILL);                                         \
    }

ssize_t write(int f, const void *data, size_t size)
{
    WRITING(write, f, size, f, data, half)
    return REAL(write)(f, data, size);
}

ssize_t pwrite(int f, const void *data, size_t size, off_t place)
{
    WRITING(pwrite, f, size, f, data, half, place)
    return REAL(pwrite)(f, data, size, place);
}

ssize_t pwrite64(int f, const void *data, size_t size, off64_t place)
{
    WRITING(pwrite64, f, size, f, data, half, place)
    return REAL(pwrite64)(f, data, size, place);
}

ssize_t writev(int f, const struct iovec *parts, int number)
{
    WRITING(writev, f, number, f, parts, half)
    return REAL(writev)(f, parts, number);
}

#define OTHER(name, ours, declared, ...)                        \
    int name declared                                           \
    {                                                           \
        if (!halves && due(ours)) {                             \
            if (failing) { errno = failing; return FAILED; }    \
            raise(SIGKILL);                                     \
        }                                                       \
        return REAL(name)(__VA_ARGS__);                         \
    }

#define FAILED -1
OTHER(ftruncate, below_file(f), (int f, off_t size), f, size)
OTHER(ftruncate64, below_file(f), (int f, off64_t size), f, size)
#undef FAILED
#define FAILED failing
OTHER(posix_fallocate, below_file(f), (int f, off_t from, off_t size), f, from, size)
OTHER(posix_fallocate64, below_file(f), (int f, off64_t from, off64_t size), f, from, size)
#undef FAILED
#define FAILED -1
OTHER(fsync, below_file(f), (int f), f)
OTHER(fdatasync, below_file(f), (int f), f)
OTHER(close, !failing && below_file(f), (int f), f)
OTHER(rename, below(to), (const char *from, const char *to), from, to)
OTHER(unlink, !failing && below(path), (const char *path), path)
