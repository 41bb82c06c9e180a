/* A library to preload: counts what a command and its processes change on the disk, and kills or fails the nth change.

   FAULTS_ROOT   only changes below this folder count
   FAULTS_STATE  a file of 8 bytes that the processes share: the number of the last change
   FAULTS_LOG    a file that gets a line per change: its number, its kind and its path
   FAULTS_AT     the number of the change that is hit; without it changes are only counted
   FAULTS_DO     killed before or after it, or torn (half of a write is done), or full (no write from then on finds
                 room)
   FAULTS_WHOM   group or self: which processes are killed
*/
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>


static const char *root, *todo = "", *whom = "group";
static size_t root_size;
static long hit = -1;
static atomic_long *last;
static int log_file = -1;

__attribute__((constructor)) static void begin(void) {
    const char *state = getenv("FAULTS_STATE"), *lines = getenv("FAULTS_LOG"), *at = getenv("FAULTS_AT");
    if (!state || !getenv("FAULTS_ROOT")) return;
    int file = syscall(SYS_openat, AT_FDCWD, state, O_RDWR | O_CLOEXEC);
    if (file < 0) return;
    void *page = mmap(NULL, sizeof(atomic_long), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    syscall(SYS_close, file);
    if (page == MAP_FAILED) return;
    last = page;
    if (lines) log_file = syscall(SYS_openat, AT_FDCWD, lines, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0666);
    if (at) hit = atol(at);
    if (getenv("FAULTS_DO")) todo = getenv("FAULTS_DO");
    if (getenv("FAULTS_WHOM")) whom = getenv("FAULTS_WHOM");
    root = getenv("FAULTS_ROOT");
    root_size = strlen(root);
}

static void die(void) {
    kill(strcmp(whom, "self") ? 0 : getpid(), SIGKILL);
    for (;;) pause();
}

/* The place of a path; of a descriptor where the path is NULL. */
static const char *place(int at, const char *path, char *text) {
    char link[64];
    ssize_t size = 0;
    if (path && path[0] == '/') {
        snprintf(text, PATH_MAX, "%s", path);
        return text;
    }
    if (!path || at != AT_FDCWD)
        snprintf(link, sizeof link, "/proc/self/fd/%d", at);
    else
        snprintf(link, sizeof link, "/proc/self/cwd");
    size = readlink(link, text, PATH_MAX - 1);
    if (size < 0) size = 0;
    text[size] = 0;
    if (path && size + strlen(path) + 2 < PATH_MAX) strcat(strcat(text, "/"), path);
    return text;
}

/* Count a change. 1: it is the one that is hit, or an earlier one was and the disk is now full. */
static int counted(const char *kind, int at, const char *path) {
    char text[PATH_MAX], line[PATH_MAX + 64];
    if (!root || strncmp(place(at, path, text), root, root_size)) return 0;
    long number = atomic_fetch_add(last, 1) + 1;
    if (log_file >= 0) {
        int size = snprintf(line, sizeof line, "%ld %s %s\n", number, kind, text + root_size);
        syscall(SYS_write, log_file, line, size);
    }
    if (hit < 0) return 0;
    if (!strcmp(todo, "full")) return number >= hit;
    if (number == hit && !strcmp(todo, "before")) die();
    return number == hit;
}

static int is_full(void) { return !strcmp(todo, "full"); }

#define REAL(name) \
    static typeof(name) *real; \
    if (!real) real = (typeof(name) *)dlsym(RTLD_NEXT, #name)

/* A change that needs no room. */
#define CHANGE(kind, at, path, call) \
    int struck = counted(kind, at, path); \
    typeof(call) result = call; \
    if (struck && !is_full()) die(); \
    return result

int rename(const char *a, const char *b) { REAL(rename); CHANGE("rename", AT_FDCWD, b, real(a, b)); }
int renameat(int i, const char *a, int j, const char *b) { REAL(renameat); CHANGE("rename", j, b, real(i, a, j, b)); }
int renameat2(int i, const char *a, int j, const char *b, unsigned flags) {
    REAL(renameat2);
    CHANGE("rename", j, b, real(i, a, j, b, flags));
}
int link(const char *a, const char *b) { REAL(link); CHANGE("link", AT_FDCWD, b, real(a, b)); }
int linkat(int i, const char *a, int j, const char *b, int flags) {
    REAL(linkat);
    CHANGE("link", j, b, real(i, a, j, b, flags));
}
int unlink(const char *a) { REAL(unlink); CHANGE("unlink", AT_FDCWD, a, real(a)); }
int unlinkat(int i, const char *a, int flags) { REAL(unlinkat); CHANGE("unlink", i, a, real(i, a, flags)); }
int rmdir(const char *a) { REAL(rmdir); CHANGE("unlink", AT_FDCWD, a, real(a)); }
int ftruncate(int file, off_t size) { REAL(ftruncate); CHANGE("truncate", file, NULL, real(file, size)); }
int ftruncate64(int file, off64_t size) { REAL(ftruncate64); CHANGE("truncate", file, NULL, real(file, size)); }

/* A write: half of it is done where it is to be torn, none where the disk is full. */
#define WRITE(file, size, call, half) \
    if (counted("write", file, NULL)) { \
        if (is_full()) { errno = ENOSPC; return -1; } \
        if (!strcmp(todo, "torn") && (size) > 1) (void)!(half); else (void)!(call); \
        die(); \
    } \
    return call

ssize_t write(int f, const void *d, size_t n) { REAL(write); WRITE(f, n, real(f, d, n), real(f, d, n / 2)); }
ssize_t pwrite(int f, const void *d, size_t n, off_t o) {
    REAL(pwrite);
    WRITE(f, n, real(f, d, n, o), real(f, d, n / 2, o));
}
ssize_t pwrite64(int f, const void *d, size_t n, off64_t o) {
    REAL(pwrite64);
    WRITE(f, n, real(f, d, n, o), real(f, d, n / 2, o));
}
ssize_t writev(int f, const struct iovec *v, int n) { REAL(writev); WRITE(f, n, real(f, v, n), real(f, v, n / 2)); }
ssize_t sendfile(int out, int in, off_t *o, size_t n) { REAL(sendfile); WRITE(out, n, real(out, in, o, n), real(out, in, o, n / 2)); }
ssize_t sendfile64(int out, int in, off64_t *o, size_t n) { REAL(sendfile64); WRITE(out, n, real(out, in, o, n), real(out, in, o, n / 2)); }

/* An opening that empties the file. */
#define OPEN(name) \
    mode_t mode = 0; \
    if (flags & (O_CREAT | O_TMPFILE)) { va_list more; va_start(more, flags); mode = va_arg(more, mode_t); va_end(more); } \
    if (!(flags & O_TRUNC)) return name; \
    CHANGE("open", at, path, name)

int open(const char *path, int flags, ...) { REAL(open); int at = AT_FDCWD; OPEN(real(path, flags, mode)); }
int open64(const char *path, int flags, ...) { REAL(open64); int at = AT_FDCWD; OPEN(real(path, flags, mode)); }
int openat(int at, const char *path, int flags, ...) { REAL(openat); OPEN(real(at, path, flags, mode)); }
int openat64(int at, const char *path, int flags, ...) { REAL(openat64); OPEN(real(at, path, flags, mode)); }
