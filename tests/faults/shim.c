/* Makes the N-th call of a kind fail, for files below one folder; loaded into a program by LD_PRELOAD.

   What Python's own functions, HDF5 and SQLite ask of the C library all passes here, so that every layer is tested and
   none has to be patched. Counting begins with fault_arm, which a test calls in the process that is to fail; the counter
   is shared with its parent, which asks fault_count how far it came. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { LEAST_ALLOCATION = 65536 };

static char folder[PATH_MAX];
static char kind[16];
static long wanted;
static int code, only_once;
static atomic_long *count;

__attribute__((constructor)) static void begin(void) {
    count = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
}

/* code > 0: errno of the failure; 0: a short read or write; -1: the process is killed before the call, -2: after it. */
void fault_arm(const char *below, const char *operation, long number, int error, int once) {
    snprintf(folder, sizeof folder, "%s", below);
    snprintf(kind, sizeof kind, "%s", operation);
    wanted = number;
    code = error;
    only_once = once;
    atomic_store(count, 0);
}

void fault_disarm(void) { folder[0] = 0; }

long fault_count(void) { return atomic_load(count); }

static int is_below(const char *path) { return strncmp(path, folder, strlen(folder)) == 0; }

static int counts_path(const char *operation, const char *path) {
    if (!folder[0] || strcmp(kind, operation) != 0 || path == NULL) return 0;
    return path[0] == '/' ? is_below(path) : strncmp(path, "..", 2) != 0;
}

static int counts_file(const char *operation, int file) {
    char link[64], path[PATH_MAX];
    if (!folder[0] || strcmp(kind, operation) != 0) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return is_below(path);
}

/* Whether this call is the one; kills where that is asked for. */
static int strikes(void) {
    long number = atomic_fetch_add(count, 1) + 1;
    int hit = only_once || code < 0 ? number == wanted : number >= wanted;
    if (hit && code == -1) kill(getpid(), SIGKILL);
    return hit;
}

static void after(int hit) {
    if (hit && code == -2) kill(getpid(), SIGKILL);
}

#define FAILS(counted, result)                                                                                         \
    int hit = (counted) && strikes();                                                                                  \
    if (hit && code > 0) {                                                                                             \
        errno = code;                                                                                                  \
        return result;                                                                                                 \
    }

#define NEXT(name)                                                                                                     \
    static __typeof__(&name) next;                                                                                     \
    if (next == NULL) next = (__typeof__(&name))dlsym(RTLD_NEXT, #name);

#define SHORT(size) (hit && code == 0 && (size) > 1 ? (size) / 2 : (size))

#define CALL(type, name, arguments, call, counted, failed)                                                             \
    type name arguments {                                                                                              \
        NEXT(name)                                                                                                     \
        FAILS(counted, failed)                                                                                         \
        type done = next call;                                                                                         \
        after(hit);                                                                                                    \
        return done;                                                                                                   \
    }

#define READ(name, arguments, call) CALL(ssize_t, name, arguments, call, counts_file("read", file), -1)
READ(read, (int file, void *data, size_t size), (file, data, SHORT(size)))
READ(pread, (int file, void *data, size_t size, off_t at), (file, data, SHORT(size), at))
READ(pread64, (int file, void *data, size_t size, off_t at), (file, data, SHORT(size), at))
READ(preadv, (int file, const struct iovec *v, int n, off_t at), (file, v, n, at))
READ(preadv64, (int file, const struct iovec *v, int n, off_t at), (file, v, n, at))
READ(preadv2, (int file, const struct iovec *v, int n, off_t at, int flags), (file, v, n, at, flags))
READ(preadv64v2, (int file, const struct iovec *v, int n, off_t at, int flags), (file, v, n, at, flags))

#define WRITE(name, arguments, call) CALL(ssize_t, name, arguments, call, counts_file("write", file), -1)
WRITE(write, (int file, const void *data, size_t size), (file, data, SHORT(size)))
WRITE(pwrite, (int file, const void *data, size_t size, off_t at), (file, data, SHORT(size), at))
WRITE(pwrite64, (int file, const void *data, size_t size, off_t at), (file, data, SHORT(size), at))
WRITE(writev, (int file, const struct iovec *v, int n), (file, v, n))

CALL(int, fsync, (int file), (file), counts_file("fsync", file), -1)
CALL(int, fdatasync, (int file), (file), counts_file("fsync", file), -1)
CALL(int, ftruncate, (int file, off_t size), (file, size), counts_file("truncate", file), -1)
CALL(int, ftruncate64, (int file, off_t size), (file, size), counts_file("truncate", file), -1)
CALL(int, posix_fallocate, (int file, off_t at, off_t size), (file, at, size), counts_file("truncate", file), code)
CALL(int, posix_fallocate64, (int file, off_t at, off_t size), (file, at, size), counts_file("truncate", file), code)
CALL(int, rename, (const char *a, const char *b), (a, b), counts_path("rename", b), -1)
CALL(int, renameat, (int d, const char *a, int e, const char *b), (d, a, e, b), counts_path("rename", b), -1)
CALL(int, link, (const char *a, const char *b), (a, b), counts_path("rename", b), -1)
CALL(int, unlink, (const char *path), (path), counts_path("unlink", path), -1)
CALL(int, unlinkat, (int d, const char *path, int flags), (d, path, flags), counts_path("unlink", path), -1)

#define OPEN(name, first_type, first)                                                                                  \
    int name(first_type const char *path, int flags, ...) {                                                            \
        va_list more;                                                                                                  \
        va_start(more, flags);                                                                                         \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0;                                        \
        va_end(more);                                                                                                  \
        NEXT(name)                                                                                                     \
        FAILS(counts_path("open", path), -1)                                                                           \
        int done = next(first path, flags, mode);                                                                      \
        after(hit);                                                                                                    \
        return done;                                                                                                   \
    }

#define NOTHING
#define COMMA ,
OPEN(open, NOTHING, NOTHING)
OPEN(open64, NOTHING, NOTHING)
OPEN(openat, int at COMMA, at COMMA)
OPEN(openat64, int at COMMA, at COMMA)

extern void *__libc_malloc(size_t);
extern void *__libc_calloc(size_t, size_t);
extern void *__libc_realloc(void *, size_t);

static int refuses(size_t size) {
    if (!folder[0] || size < LEAST_ALLOCATION || strcmp(kind, "alloc") != 0 || !strikes()) return 0;
    errno = ENOMEM;
    return 1;
}

void *malloc(size_t size) { return refuses(size) ? NULL : __libc_malloc(size); }

void *calloc(size_t number, size_t size) { return refuses(number * size) ? NULL : __libc_calloc(number, size); }

void *realloc(void *old, size_t size) { return refuses(size) ? NULL : __libc_realloc(old, size); }
