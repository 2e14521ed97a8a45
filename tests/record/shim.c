/* Records what a process does to the files under one folder, and makes chosen operations fail.

   cc -shared -fPIC -O2 -o shim.so shim.c -ldl; LD_PRELOAD=./shim.so python ...

   Nothing happens before watch() is called. From then on each call that changes a file or a name
   under the folder is one record in the log: a head, the path, the other path (of a rename or a
   link), the bytes that were written. Operations are counted from 0; one that was made to fail is
   in the log too, with its errno. A file is known by the name it has at the time of the call, so
   that descriptors need not be followed through dup and close. */

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
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum kind { OPEN = 1, WRITE, TRUNCATE, ALLOCATE, RENAME, UNLINK, SYNC, LINK, MARK };
enum how { ONCE, ALWAYS, SHORT, FULL }; /* FULL: half of one write, then nothing more */

struct head {
    uint32_t kind, flags;
    int64_t offset, size;
    int32_t error;
    uint32_t path, other, data; /* bytes that follow */
};

static char folder[PATH_MAX];
static size_t folder_length; /* 0: nothing is watched */
static int log_file = -1;
static long count, fail_at = -1;
static int fail_error, fail_how;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

#define NEXT(name) \
    static __typeof__(name) *next; \
    if (!next) next = (__typeof__(name) *)dlsym(RTLD_NEXT, #name)

void unwatch(void) { folder_length = 0; }

/* Begin: folder and log are absolute and without links; fail_at < 0: nothing fails. */
void watch(const char *path, const char *log, long at, int error, int how)
{
    unwatch();
    if (log_file >= 0) syscall(SYS_close, log_file);
    int low = syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_CREAT | O_TRUNC | O_APPEND, 0600);
    log_file = syscall(SYS_fcntl, low, F_DUPFD_CLOEXEC, 900);
    syscall(SYS_close, low);
    count = 0, fail_at = at, fail_error = error, fail_how = how;
    snprintf(folder, sizeof folder, "%s", path);
    folder_length = strlen(folder);
}

static int is_inside(const char *path)
{
    if (!folder_length || strncmp(path, folder, folder_length)) return 0;
    return path[folder_length] == '/' || !path[folder_length];
}

/* Name of an open regular file or folder under the watched one; 0 where it is none. */
static int name_of(int fd, char *name)
{
    char link[64];
    if (!folder_length || fd < 0) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = syscall(SYS_readlink, link, name, PATH_MAX - 1);
    if (n <= 0) return 0;
    name[n] = 0;
    return is_inside(name);
}

/* Absolute name that a path stands for: links on the way to it are followed, the last is not. */
static int resolve(int at, const char *path, char *name)
{
    char whole[2 * PATH_MAX], parent[PATH_MAX];
    if (!folder_length || !path) return 0;
    if (path[0] == '/') {
        snprintf(whole, sizeof whole, "%s", path);
    } else {
        if (at == AT_FDCWD) {
            if (!getcwd(parent, sizeof parent)) return 0;
        } else {
            char link[64];
            snprintf(link, sizeof link, "/proc/self/fd/%d", at);
            ssize_t n = syscall(SYS_readlink, link, parent, PATH_MAX - 1);
            if (n <= 0) return 0;
            parent[n] = 0;
        }
        snprintf(whole, sizeof whole, "%s/%s", parent, path);
    }
    char *slash = strrchr(whole, '/');
    *slash = 0;
    int before = errno;
    if (!realpath(whole[0] ? whole : "/", parent)) {
        errno = before;
        return 0;
    }
    snprintf(name, PATH_MAX, "%.*s/%s", PATH_MAX / 2, parent, slash + 1);
    return is_inside(name);
}

static void put(const void *bytes, size_t n)
{
    for (const char *p = bytes; n;) {
        ssize_t done = syscall(SYS_write, log_file, p, n);
        if (done <= 0) abort();
        p += done, n -= done;
    }
}

static void note(int kind, int flags, int64_t offset, int64_t size, int error, const char *path,
                 const char *other, const void *data, size_t n)
{
    int before = errno;
    struct head head = {kind, flags, offset, size, error, strlen(path), other ? strlen(other) : 0, n};
    put(&head, sizeof head);
    put(path, head.path);
    if (other) put(other, head.other);
    put(data, n);
    errno = before;
}

/* Note that so many frames are promised to be kept. */
void mark(long frames)
{
    pthread_mutex_lock(&lock);
    if (folder_length) note(MARK, 0, 0, frames, 0, folder, NULL, NULL, 0);
    pthread_mutex_unlock(&lock);
}

/* Count an operation; whether it shall fail now: 1, or write only half: 2. */
static int chosen(int needs_room)
{
    long k = count++;
    if (fail_at < 0 || k < fail_at) return 0;
    if (fail_error != EIO && !needs_room) return 0; /* a full disk still shrinks and removes */
    if (k == fail_at && (fail_how == SHORT || fail_how == FULL)) return 2;
    if (k == fail_at) return fail_how == ONCE || fail_how == ALWAYS;
    return fail_how == ALWAYS || fail_how == FULL;
}

/* Opening and making */

static int opened(int fd, int flags, const char *given)
{
    char name[PATH_MAX];
    if (fd >= 0 && (flags & (O_CREAT | O_TRUNC))) {
        if (!name_of(fd, name)) return fd;
        note(OPEN, flags, 0, 0, 0, name, NULL, NULL, 0);
    } else if (fd < 0 && given) {
        note(OPEN, flags, 0, 0, errno, given, NULL, NULL, 0);
    }
    return fd;
}

#define OPENS(name, parameters, arguments, at) \
    int name parameters \
    { \
        NEXT(name); \
        mode_t mode = 0; \
        if (flags & (O_CREAT | O_TMPFILE)) { \
            va_list list; \
            va_start(list, flags); \
            mode = va_arg(list, int); \
            va_end(list); \
        } \
        char full[PATH_MAX]; \
        if (!(flags & (O_CREAT | O_TRUNC)) || !resolve(at, path, full)) return next arguments; \
        pthread_mutex_lock(&lock); \
        int fd = -1; \
        struct stat is_there; \
        int makes = fstatat(AT_FDCWD, full, &is_there, 0) != 0; \
        if (makes && !(flags & O_CREAT)) fd = next arguments; /* fails by itself */ \
        else if (chosen(makes) == 1) errno = fail_error, opened(-1, flags, full); \
        else { \
            fd = next arguments; \
            if (fd < 0) count--; \
            else opened(fd, flags, full); \
        } \
        pthread_mutex_unlock(&lock); \
        return fd; \
    }

OPENS(open, (const char *path, int flags, ...), (path, flags, mode), AT_FDCWD)
OPENS(open64, (const char *path, int flags, ...), (path, flags, mode), AT_FDCWD)
OPENS(openat, (int folder_fd, const char *path, int flags, ...), (folder_fd, path, flags, mode), folder_fd)
OPENS(openat64, (int folder_fd, const char *path, int flags, ...), (folder_fd, path, flags, mode), folder_fd)

/* Writing */

static ssize_t written(int fd, const struct iovec *parts, int n_parts, int64_t offset, const char *name)
{
    size_t n = 0;
    for (int i = 0; i < n_parts; i++) n += parts[i].iov_len;
    char *bytes = malloc(n ? n : 1), *p = bytes;
    for (int i = 0; i < n_parts; i++) {
        memcpy(p, parts[i].iov_base, parts[i].iov_len);
        p += parts[i].iov_len;
    }
    int moves = offset < 0;
    if (moves) {
        int flags = syscall(SYS_fcntl, fd, F_GETFL);
        offset = syscall(SYS_lseek, fd, 0, flags & O_APPEND ? SEEK_END : SEEK_CUR);
    }
    int fails = chosen(1);
    ssize_t done = -1;
    if (fails == 1) {
        errno = fail_error;
    } else {
        size_t wanted = fails == 2 && n > 1 ? n / 2 : n;
        done = moves ? syscall(SYS_write, fd, bytes, wanted)
                     : syscall(SYS_pwrite64, fd, bytes, wanted, offset);
    }
    note(WRITE, 0, offset, n, done < 0 ? errno : 0, name, NULL, bytes, done < 0 ? 0 : done);
    free(bytes);
    return done;
}

static ssize_t write_all(int fd, const struct iovec *parts, int n, int64_t offset, const char *name)
{
    pthread_mutex_lock(&lock);
    ssize_t done = written(fd, parts, n, offset, name);
    pthread_mutex_unlock(&lock);
    return done;
}

#define ONE {{(void *)data, n}}

ssize_t write(int fd, const void *data, size_t n)
{
    NEXT(write);
    char name[PATH_MAX];
    if (!name_of(fd, name)) return next(fd, data, n);
    return write_all(fd, (struct iovec[])ONE, 1, -1, name);
}

#define PWRITES(call, offset_t) \
    ssize_t call(int fd, const void *data, size_t n, offset_t offset) \
    { \
        NEXT(call); \
        char name[PATH_MAX]; \
        if (!name_of(fd, name)) return next(fd, data, n, offset); \
        return write_all(fd, (struct iovec[])ONE, 1, offset, name); \
    }

PWRITES(pwrite, off_t)
PWRITES(pwrite64, off64_t)

ssize_t writev(int fd, const struct iovec *parts, int n)
{
    NEXT(writev);
    char name[PATH_MAX];
    if (!name_of(fd, name)) return next(fd, parts, n);
    return write_all(fd, parts, n, -1, name);
}

#define PWRITEVS(call, parameters, arguments) \
    ssize_t call parameters \
    { \
        NEXT(call); \
        char name[PATH_MAX]; \
        if (!name_of(fd, name)) return next arguments; \
        return write_all(fd, parts, n, offset, name); \
    }

PWRITEVS(pwritev, (int fd, const struct iovec *parts, int n, off_t offset), (fd, parts, n, offset))
PWRITEVS(pwritev64, (int fd, const struct iovec *parts, int n, off64_t offset), (fd, parts, n, offset))
PWRITEVS(pwritev2, (int fd, const struct iovec *parts, int n, off_t offset, int flags), (fd, parts, n, offset, flags))
PWRITEVS(pwritev64v2, (int fd, const struct iovec *parts, int n, off64_t offset, int flags), (fd, parts, n, offset, flags))

/* Sizes */

#define CHANGES(kind, needs_room, offset, size, name, other, act, failure) \
    pthread_mutex_lock(&lock); \
    __typeof__(act) result = failure; \
    if (chosen(needs_room) == 1) errno = fail_error; \
    else result = act; \
    int error = result ? (result > 0 ? (int)result : errno) : 0; \
    note(kind, 0, offset, size, error, name, other, NULL, 0); \
    pthread_mutex_unlock(&lock); \
    return result

#define FTRUNCATES(call, offset_t) \
    int call(int fd, offset_t size) \
    { \
        NEXT(call); \
        char name[PATH_MAX]; \
        struct stat now; \
        if (!name_of(fd, name)) return next(fd, size); \
        int grows = !fstat(fd, &now) && size > now.st_size; \
        CHANGES(TRUNCATE, grows, 0, size, name, NULL, next(fd, size), -1); \
    }

FTRUNCATES(ftruncate, off_t)
FTRUNCATES(ftruncate64, off64_t)

#define TRUNCATES(call, offset_t) \
    int call(const char *path, offset_t size) \
    { \
        NEXT(call); \
        char name[PATH_MAX]; \
        if (!resolve(AT_FDCWD, path, name)) return next(path, size); \
        CHANGES(TRUNCATE, 1, 0, size, name, NULL, next(path, size), -1); \
    }

TRUNCATES(truncate, off_t)
TRUNCATES(truncate64, off64_t)

#define ALLOCATES(call, offset_t) \
    int call(int fd, offset_t offset, offset_t size) \
    { \
        NEXT(call); \
        char name[PATH_MAX]; \
        if (!name_of(fd, name)) return next(fd, offset, size); \
        CHANGES(ALLOCATE, 1, offset, size, name, NULL, next(fd, offset, size), fail_error); \
    }

ALLOCATES(posix_fallocate, off_t)
ALLOCATES(posix_fallocate64, off64_t)

/* Names */

#define RENAMES(call, parameters, arguments, at_old, at_new, kind) \
    int call parameters \
    { \
        NEXT(call); \
        char from[PATH_MAX], to[PATH_MAX]; \
        int inside = resolve(at_old, old, from); \
        if (!resolve(at_new, new, to) && !inside) return next arguments; \
        CHANGES(kind, 0, 0, 0, from, to, next arguments, -1); \
    }

RENAMES(rename, (const char *old, const char *new), (old, new), AT_FDCWD, AT_FDCWD, RENAME)
RENAMES(renameat, (int a, const char *old, int b, const char *new), (a, old, b, new), a, b, RENAME)
RENAMES(link, (const char *old, const char *new), (old, new), AT_FDCWD, AT_FDCWD, LINK)
RENAMES(linkat, (int a, const char *old, int b, const char *new, int flags), (a, old, b, new, flags), a, b, LINK)

#define UNLINKS(call, parameters, arguments, at) \
    int call parameters \
    { \
        NEXT(call); \
        char name[PATH_MAX]; \
        if (!resolve(at, path, name)) return next arguments; \
        CHANGES(UNLINK, 0, 0, 0, name, NULL, next arguments, -1); \
    }

UNLINKS(unlink, (const char *path), (path), AT_FDCWD)
UNLINKS(remove, (const char *path), (path), AT_FDCWD)
UNLINKS(unlinkat, (int at, const char *path, int flags), (at, path, flags), at)

#define SYNCS(call) \
    int call(int fd) \
    { \
        NEXT(call); \
        char name[PATH_MAX]; \
        if (!name_of(fd, name)) return next(fd); \
        CHANGES(SYNC, 1, 0, 0, name, NULL, 0, -1); /* the disk's own time is not wanted here */ \
    }

SYNCS(fsync)
SYNCS(fdatasync)
