/* Makes the n-th call on files below a folder fail. Loaded with LD_PRELOAD; see faults.py.
 *
 * Counted are calls that create, write, sync, name or close, by Python and by libraries in C:
 * open (also to read), creat, fopen, write, pwrite, writev, sendfile, copy_file_range, fsync,
 * fdatasync, ftruncate, close of a file opened to write, rename, link, symlink, mkdir.
 * What glibc writes for FILE streams is not seen: it does not call these functions by name.
 *
 * A process sets folder and number itself with nth_arm, so that one that was forked can.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { DESCRIPTORS = 65536, LISTED = 1 << 20 };
enum { READING = 1, WRITING = 2 };

static char folder[PATH_MAX];
static size_t folder_length;
static atomic_long count;
static long fail_at; /* from 1; 0 counts only */
static int fail_with, fail_on; /* fail_on: whether all later writes fail too */
static atomic_uchar tracked[DESCRIPTORS];
static char failed_call[PATH_MAX + 64];
static pid_t owner; /* other processes are not counted */
static char list[LISTED]; /* a line for each call that was counted, as far as there is room */
static size_t list_length;
static pthread_mutex_t listing = PTHREAD_MUTEX_INITIALIZER;

void nth_arm(const char *below, long n, int number, int stays) {
    snprintf(folder, sizeof folder, "%s", below);
    folder_length = strlen(folder);
    fail_at = n, fail_with = number, fail_on = stays;
    count = 0;
    failed_call[0] = 0;
    list[0] = 0;
    list_length = 0;
    owner = getpid();
}

long nth_count(void) { return count; }

const char *nth_failed(void) { return failed_call; }

const char *nth_list(void) { return list; }

/* Count a call, and list it; return its number. */
static long counted(const char *call, const char *path) {
    pthread_mutex_lock(&listing);
    long number = atomic_fetch_add(&count, 1) + 1;
    size_t room = sizeof list - list_length;
    int length = snprintf(list + list_length, room, "%s %s\n", call, path);
    if (length < (int)room) list_length += length;
    else list[list_length] = 0;
    pthread_mutex_unlock(&listing);
    return number;
}

/* Count a call; return whether it has to fail. */
static int fails(const char *call, const char *path, int is_write) {
    if (getpid() != owner) return 0;
    long number = counted(call, path);
    if (!fail_at || number < fail_at) return 0;
    if (number > fail_at && !(fail_on && is_write)) return 0;
    if (number == fail_at) snprintf(failed_call, sizeof failed_call, "%s %s", call, path);
    errno = fail_with;
    return 1;
}

static int is_below(int at, const char *path, char *whole) {
    if (!folder_length || !path) return 0;
    if (path[0] == '/') {
        snprintf(whole, PATH_MAX, "%s", path);
    } else {
        char base[PATH_MAX] = "";
        if (at == AT_FDCWD) {
            if (!getcwd(base, sizeof base)) return 0;
        } else {
            char link[64];
            snprintf(link, sizeof link, "/proc/self/fd/%d", at);
            ssize_t length = readlink(link, base, sizeof base - 1);
            if (length < 0) return 0;
            base[length] = 0;
        }
        if (snprintf(whole, PATH_MAX, "%s/%s", base, path) >= PATH_MAX) return 0;
    }
    return !strncmp(whole, folder, folder_length) &&
           (whole[folder_length] == '/' || !whole[folder_length]);
}

static unsigned char kind_of(int fd) {
    return fd >= 0 && fd < DESCRIPTORS && getpid() == owner ? tracked[fd] : 0;
}

static const char *name_of(int fd, char *name) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, name, PATH_MAX - 1);
    name[length < 0 ? 0 : length] = 0;
    return name;
}

#define REAL(type, name, ...)                             \
    static type (*real)(__VA_ARGS__);                     \
    if (!real) real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

static int opened(int fd, int flags) {
    if (fd >= 0 && fd < DESCRIPTORS)
        tracked[fd] = (flags & O_ACCMODE) == O_RDONLY ? READING : WRITING;
    return fd;
}

/* A file that is only looked for, and not there, is no call that fails. */
static int opens(const char *call, const char *path, int flags) {
    int number = errno, missing = !(flags & O_CREAT) && access(path, F_OK);
    errno = number;
    return !missing && fails(call, path, flags & O_CREAT);
}

#define OPEN(NAME)                                                    \
    int NAME(const char *path, int flags, ...) {                      \
        REAL(int, #NAME, const char *, int, ...);                     \
        va_list rest;                                                 \
        va_start(rest, flags);                                        \
        mode_t mode = va_arg(rest, mode_t);                           \
        va_end(rest);                                                 \
        char whole[PATH_MAX];                                         \
        if (!is_below(AT_FDCWD, path, whole)) {                       \
            int fd = real(path, flags, mode);                         \
            if (fd >= 0 && fd < DESCRIPTORS) tracked[fd] = 0;         \
            return fd;                                                \
        }                                                             \
        if (opens(#NAME, whole, flags)) return -1;          \
        return opened(real(path, flags, mode), flags);                \
    }
OPEN(open)
OPEN(open64)

#define OPENAT(NAME)                                                  \
    int NAME(int at, const char *path, int flags, ...) {              \
        REAL(int, #NAME, int, const char *, int, ...);                \
        va_list rest;                                                 \
        va_start(rest, flags);                                        \
        mode_t mode = va_arg(rest, mode_t);                           \
        va_end(rest);                                                 \
        char whole[PATH_MAX];                                         \
        if (!is_below(at, path, whole)) {                             \
            int fd = real(at, path, flags, mode);                     \
            if (fd >= 0 && fd < DESCRIPTORS) tracked[fd] = 0;         \
            return fd;                                                \
        }                                                             \
        if (opens(#NAME, whole, flags)) return -1;          \
        return opened(real(at, path, flags, mode), flags);            \
    }
OPENAT(openat)
OPENAT(openat64)

#define FOPEN(NAME)                                                   \
    FILE *NAME(const char *path, const char *mode) {                  \
        REAL(FILE *, #NAME, const char *, const char *);              \
        char whole[PATH_MAX];                                         \
        if (is_below(AT_FDCWD, path, whole)) {                        \
            if (fails(#NAME, whole, mode[0] != 'r')) return NULL;     \
            FILE *file = real(path, mode);                            \
            if (file) opened(fileno(file), mode[0] == 'r' ? O_RDONLY : O_WRONLY); \
            return file;                                              \
        }                                                             \
        return real(path, mode);                                      \
    }
FOPEN(fopen)
FOPEN(fopen64)

int creat(const char *path, mode_t mode) {
    return open(path, O_CREAT | O_WRONLY | O_TRUNC, mode);
}

#define ON_FILE(type, NAME, parameters, arguments, ...)               \
    type NAME parameters {                                            \
        REAL(type, #NAME, __VA_ARGS__);                               \
        char name[PATH_MAX];                                          \
        if (kind_of(fd) && fails(#NAME, name_of(fd, name), 1)) return -1; \
        return real arguments;                                        \
    }
ON_FILE(ssize_t, write, (int fd, const void *data, size_t size), (fd, data, size), int, const void *, size_t)
ON_FILE(ssize_t, pwrite, (int fd, const void *data, size_t size, off_t at), (fd, data, size, at), int, const void *, size_t, off_t)
ON_FILE(ssize_t, pwrite64, (int fd, const void *data, size_t size, off64_t at), (fd, data, size, at), int, const void *, size_t, off64_t)
ON_FILE(ssize_t, writev, (int fd, const struct iovec *parts, int number), (fd, parts, number), int, const struct iovec *, int)
ON_FILE(ssize_t, sendfile, (int fd, int from, off_t *at, size_t size), (fd, from, at, size), int, int, off_t *, size_t)
ON_FILE(ssize_t, sendfile64, (int fd, int from, off64_t *at, size_t size), (fd, from, at, size), int, int, off64_t *, size_t)
ON_FILE(int, fsync, (int fd), (fd), int)
ON_FILE(int, fdatasync, (int fd), (fd), int)
ON_FILE(int, ftruncate, (int fd, off_t size), (fd, size), int, off_t)
ON_FILE(int, ftruncate64, (int fd, off64_t size), (fd, size), int, off64_t)

ssize_t copy_file_range(int from, off64_t *at, int fd, off64_t *to, size_t size, unsigned flags) {
    REAL(ssize_t, "copy_file_range", int, off64_t *, int, off64_t *, size_t, unsigned);
    char name[PATH_MAX];
    if (kind_of(fd) && fails("copy_file_range", name_of(fd, name), 1)) return -1;
    return real(from, at, fd, to, size, flags);
}

int close(int fd) {
    REAL(int, "close", int);
    unsigned char kind = kind_of(fd);
    if (fd >= 0 && fd < DESCRIPTORS) tracked[fd] = 0;
    char name[PATH_MAX];
    int failed = kind == WRITING && fails("close", name_of(fd, name), 1);
    int number = errno, result = real(fd); /* it is closed in any case, as on Linux */
    if (!failed) return result;
    errno = number;
    return -1;
}

int dup2(int fd, int other) {
    REAL(int, "dup2", int, int);
    int result = real(fd, other);
    if (result >= 0 && result < DESCRIPTORS) tracked[result] = kind_of(fd);
    return result;
}

#define ON_PATHS(NAME, parameters, arguments, place, path, ...)       \
    int NAME parameters {                                             \
        REAL(int, #NAME, __VA_ARGS__);                                \
        char whole[PATH_MAX];                                         \
        if (is_below(place, path, whole) && fails(#NAME, whole, 1)) return -1; \
        return real arguments;                                        \
    }
ON_PATHS(rename, (const char *a, const char *b), (a, b), AT_FDCWD, b, const char *, const char *)
ON_PATHS(renameat, (int x, const char *a, int y, const char *b), (x, a, y, b), y, b, int, const char *, int, const char *)
ON_PATHS(renameat2, (int x, const char *a, int y, const char *b, unsigned f), (x, a, y, b, f), y, b, int, const char *, int, const char *, unsigned)
ON_PATHS(link, (const char *a, const char *b), (a, b), AT_FDCWD, b, const char *, const char *)
ON_PATHS(linkat, (int x, const char *a, int y, const char *b, int f), (x, a, y, b, f), y, b, int, const char *, int, const char *, int)
ON_PATHS(symlink, (const char *a, const char *b), (a, b), AT_FDCWD, b, const char *, const char *)
ON_PATHS(symlinkat, (const char *a, int y, const char *b), (a, y, b), y, b, const char *, int, const char *)

/* A folder that is there need not be made: callers take any error for that. */
static int makes(const char *call, const char *path) {
    int number = errno, there = !access(path, F_OK);
    errno = number;
    return !there && fails(call, path, 1);
}

int mkdir(const char *path, mode_t mode) {
    REAL(int, "mkdir", const char *, mode_t);
    char whole[PATH_MAX];
    if (is_below(AT_FDCWD, path, whole) && makes("mkdir", whole)) return -1;
    return real(path, mode);
}

int mkdirat(int at, const char *path, mode_t mode) {
    REAL(int, "mkdirat", int, const char *, mode_t);
    char whole[PATH_MAX];
    if (is_below(at, path, whole) && makes("mkdirat", whole)) return -1;
    return real(at, path, mode);
}
