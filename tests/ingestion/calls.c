// Counts the calls that change files of a folder, lets one of them fail, and records those that do not.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static char folder[4096], path[4096];
static long chosen = -1, seen;
static int code;
static FILE *trace;

void fail_write(const char *place, long number, int error) {
    strncpy(folder, place, sizeof folder - 1);
    chosen = number;
    code = error;
    seen = 0;
}

long writes_seen(void) { return seen; }

void record(const char *place, const char *file) {
    strncpy(folder, place, sizeof folder - 1);
    trace = fopen(file, "wb");
}

void note(char kind, const char *name, long at, long size, const void *data) {
    if (!trace || strncmp(name, folder, strlen(folder))) return;
    fprintf(trace, "%c %ld %ld %s\n", kind, at, size, name);
    if (data) fwrite(data, 1, size, trace);
    fflush(trace);
}

static int is_inside(int file) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    path[length < 0 ? 0 : length] = 0;
    return *folder && !strncmp(path, folder, strlen(folder));
}

#define CALL(result, name, parameters, arguments, kind, at, data)                         \
    result name parameters {                                                              \
        result (*actual) parameters = (result (*) parameters)dlsym(RTLD_NEXT, #name);     \
        if (!is_inside(file)) return actual arguments;                                    \
        if (chosen >= 0 && seen++ == chosen) {                                            \
            errno = code;                                                                 \
            return -1;                                                                    \
        }                                                                                 \
        result done = actual arguments;                                                   \
        if (done >= 0) note(kind, path, at, done, data);                                  \
        return done;                                                                      \
    }

#define END lseek(file, 0, SEEK_CUR) - done
CALL(ssize_t, write, (int file, const void *data, size_t size), (file, data, size), 'w', END, data)
CALL(ssize_t, pwrite, (int file, const void *data, size_t n, off_t at), (file, data, n, at), 'w', at, data)
CALL(ssize_t, pwrite64, (int file, const void *data, size_t n, off_t at), (file, data, n, at), 'w', at, data)
CALL(int, ftruncate, (int file, off_t size), (file, size), 't', size, NULL)
CALL(int, ftruncate64, (int file, off64_t size), (file, size), 't', size, NULL)
CALL(int, fsync, (int file), (file), 's', 0, NULL)
CALL(int, fdatasync, (int file), (file), 's', 0, NULL)

int unlink(const char *name) {
    int (*actual)(const char *) = (int (*)(const char *))dlsym(RTLD_NEXT, "unlink");
    int done = actual(name);
    if (!done) note('u', name, 0, 0, NULL);
    return done;
}
