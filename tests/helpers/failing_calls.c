/* Watches the calls on files inside one folder, for LD_PRELOAD: records them, and lets a chosen one fail.

   It sees what every library does, HDF5 too.  Asleep until `watch_calls` is called. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

enum call { OPEN = 1, WRITE = 2, TRUNCATE = 4, ALLOCATE = 8, SYNC = 16, RENAME = 32, UNLINK = 64, MKDIR = 128,
            RMDIR = 256, CLOSE = 512, MARK = 1024 };
enum { FILES = 65536, SHORT = -1 };
enum { ONCE, FROM_THEN_ON };

struct record { uint32_t call; int32_t file; int64_t offset; uint32_t first, second; };

static char folder[PATH_MAX];
static size_t length;
static int record_to = -1, failing, reason, how_often;
static long nth, *seen;
static char ours[FILES];
static pthread_mutex_t one = PTHREAD_MUTEX_INITIALIZER;

/* Calls from here on count; those of the kinds `calls` do.  reason: errno of the n-th, or -1 for a short write. */
void watch_calls(const char *where, int record_file, int calls, long n, int why, int often, long *counter)
{
    snprintf(folder, sizeof folder, "%s", where);
    record_to = record_file, failing = calls, nth = n, reason = why, how_often = often, seen = counter;
    length = strlen(folder);
}

static int inside(int at, const char *path, char *full)
{
    char start[PATH_MAX] = "";
    if (!length || !path)
        return 0;
    if (path[0] != '/') {
        char link[64];
        snprintf(link, sizeof link, at == AT_FDCWD ? "/proc/self/cwd" : "/proc/self/fd/%d", at);
        ssize_t n = readlink(link, start, sizeof start - 2);
        if (n < 0)
            return 0;
        start[n] = '/', start[n + 1] = 0;
    }
    if (snprintf(full, PATH_MAX, "%s%s", start, path) >= PATH_MAX)
        return 0;
    size_t n = strlen(full);
    while (n > 1 && full[n - 1] == '/')
        full[--n] = 0;
    return !strncmp(full, folder, length) && (!full[length] || full[length] == '/');
}

static int is_ours(int file) { return length && file >= 0 && file < FILES && ours[file]; }

/* Whether this call is to fail; locks, until `leave`. */
static int enter(enum call call)
{
    pthread_mutex_lock(&one);
    if (!(failing & call))
        return 0;
    ++*seen;
    if (!nth || *seen < nth)
        return 0;
    return *seen == nth || how_often == FROM_THEN_ON;
}

static void put(const void *data, size_t n)
{
    static ssize_t (*real)(int, const void *, size_t);
    if (!real)
        real = (ssize_t (*)(int, const void *, size_t))dlsym(RTLD_NEXT, "write");
    for (const char *p = data; n;) {
        ssize_t done = real(record_to, p, n);
        if (done <= 0)
            abort();
        p += done, n -= done;
    }
}

static void record(enum call call, int file, int64_t offset, const void *a, size_t n, const void *b, size_t m)
{
    int before = errno;
    struct record head = {call, file, offset, n, m};
    if (record_to >= 0)
        put(&head, sizeof head), put(a, n), put(b, m);
    errno = before;
}

static void leave(void) { pthread_mutex_unlock(&one); }

void mark(const char *word)
{
    pthread_mutex_lock(&one);
    record(MARK, -1, 0, word, strlen(word), "", 0);
    leave();
}

#define REAL(type, name, ...)                                                                                          \
    static type (*real)(__VA_ARGS__);                                                                                  \
    if (!real)                                                                                                         \
        real = (type (*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

static int opened(int at, const char *path, int flags, mode_t mode)
{
    REAL(int, "openat64", int, const char *, int, ...);
    char full[PATH_MAX];
    if (!inside(at, path, full)) {
        int file = real(at, path, flags, mode);
        if (file >= 0 && file < FILES)
            ours[file] = 0;
        return file;
    }
    int file = -1;
    if (enter(OPEN) && reason != SHORT)
        errno = reason;
    else if ((file = real(at, path, flags, mode)) >= 0 && file < FILES) {
        ours[file] = 1;
        record(OPEN, file, flags & (O_TRUNC | O_CREAT | O_TMPFILE), full, strlen(full), "", 0);
    }
    leave();
    return file;
}

#define MODE(flags)                                                                                                    \
    mode_t mode = 0;                                                                                                   \
    if (flags & (O_CREAT | __O_TMPFILE)) {                                                                             \
        va_list more;                                                                                                  \
        va_start(more, flags);                                                                                         \
        mode = va_arg(more, mode_t);                                                                                   \
        va_end(more);                                                                                                  \
    }

int open(const char *path, int flags, ...) { MODE(flags) return opened(AT_FDCWD, path, flags, mode); }
int open64(const char *path, int flags, ...) { MODE(flags) return opened(AT_FDCWD, path, flags, mode); }
int openat(int at, const char *path, int flags, ...) { MODE(flags) return opened(at, path, flags, mode); }
int openat64(int at, const char *path, int flags, ...) { MODE(flags) return opened(at, path, flags, mode); }
int __open_2(const char *path, int flags) { return opened(AT_FDCWD, path, flags, 0); }
int __open64_2(const char *path, int flags) { return opened(AT_FDCWD, path, flags, 0); }

int close(int file)
{
    REAL(int, "close", int);
    if (is_ours(file)) {
        enter(CLOSE);
        ours[file] = 0;
        record(CLOSE, file, 0, "", 0, "", 0);
        int found = real(file);
        leave();
        return found;
    }
    return real(file);
}

ssize_t write(int file, const void *data, size_t n)
{
    REAL(ssize_t, "write", int, const void *, size_t);
    if (!is_ours(file))
        return real(file, data, n);
    int fails = enter(WRITE);
    ssize_t done = -1;
    if (fails && reason != SHORT)
        errno = reason;
    else {
        off_t at = lseek(file, 0, SEEK_CUR);
        if ((fcntl(file, F_GETFL) & O_APPEND))
            at = lseek(file, 0, SEEK_END);
        done = real(file, data, fails ? (n + 1) / 2 : n);
        if (done > 0)
            record(WRITE, file, at, data, done, "", 0);
    }
    leave();
    return done;
}

ssize_t pwrite64(int file, const void *data, size_t n, off64_t at)
{
    REAL(ssize_t, "pwrite64", int, const void *, size_t, off64_t);
    if (!is_ours(file))
        return real(file, data, n, at);
    int fails = enter(WRITE);
    ssize_t done = -1;
    if (fails && reason != SHORT)
        errno = reason;
    else if ((done = real(file, data, fails ? (n + 1) / 2 : n, at)) > 0)
        record(WRITE, file, at, data, done, "", 0);
    leave();
    return done;
}

ssize_t pwrite(int file, const void *data, size_t n, off_t at) { return pwrite64(file, data, n, at); }

int ftruncate64(int file, off64_t size)
{
    REAL(int, "ftruncate64", int, off64_t);
    if (!is_ours(file))
        return real(file, size);
    int found = -1;
    if (enter(TRUNCATE) && reason != SHORT)
        errno = reason;
    else if (!(found = real(file, size)))
        record(TRUNCATE, file, size, "", 0, "", 0);
    leave();
    return found;
}

int ftruncate(int file, off_t size) { return ftruncate64(file, size); }

int posix_fallocate64(int file, off64_t at, off64_t size)
{
    REAL(int, "posix_fallocate64", int, off64_t, off64_t);
    if (!is_ours(file))
        return real(file, at, size);
    int found = enter(ALLOCATE) && reason != SHORT ? reason : real(file, at, size);
    leave();
    return found;
}

int posix_fallocate(int file, off_t at, off_t size) { return posix_fallocate64(file, at, size); }

#define SYNCING(name)                                                                                                  \
    int name(int file)                                                                                                 \
    {                                                                                                                  \
        REAL(int, #name, int);                                                                                         \
        if (!is_ours(file))                                                                                            \
            return real(file);                                                                                         \
        int found = -1;                                                                                                \
        if (enter(SYNC) && reason != SHORT)                                                                            \
            errno = reason;                                                                                            \
        else if (!(found = real(file)))                                                                                \
            record(SYNC, file, 0, "", 0, "", 0);                                                                       \
        leave();                                                                                                       \
        return found;                                                                                                  \
    }

SYNCING(fsync)
SYNCING(fdatasync)

int renameat(int from_at, const char *from, int to_at, const char *to)
{
    REAL(int, "renameat", int, const char *, int, const char *);
    char source[PATH_MAX], target[PATH_MAX];
    if (!inside(from_at, from, source) || !inside(to_at, to, target))
        return real(from_at, from, to_at, to);
    int found = -1;
    if (enter(RENAME) && reason != SHORT)
        errno = reason;
    else if (!(found = real(from_at, from, to_at, to)))
        record(RENAME, -1, 0, source, strlen(source), target, strlen(target));
    leave();
    return found;
}

int rename(const char *from, const char *to) { return renameat(AT_FDCWD, from, AT_FDCWD, to); }

int unlinkat(int at, const char *path, int flags)
{
    REAL(int, "unlinkat", int, const char *, int);
    char full[PATH_MAX];
    if (!inside(at, path, full))
        return real(at, path, flags);
    enum call call = flags & AT_REMOVEDIR ? RMDIR : UNLINK;
    int found = -1;
    if (enter(call) && reason != SHORT)
        errno = reason;
    else if (!(found = real(at, path, flags)))
        record(call, -1, 0, full, strlen(full), "", 0);
    leave();
    return found;
}

int unlink(const char *path) { return unlinkat(AT_FDCWD, path, 0); }
int rmdir(const char *path) { return unlinkat(AT_FDCWD, path, AT_REMOVEDIR); }

int mkdirat(int at, const char *path, mode_t mode)
{
    REAL(int, "mkdirat", int, const char *, mode_t);
    char full[PATH_MAX];
    if (!inside(at, path, full))
        return real(at, path, mode);
    int found = -1;
    if (enter(MKDIR) && reason != SHORT)
        errno = reason;
    else if (!(found = real(at, path, mode)))
        record(MKDIR, -1, 0, full, strlen(full), "", 0);
    leave();
    return found;
}

int mkdir(const char *path, mode_t mode) { return mkdirat(AT_FDCWD, path, mode); }
