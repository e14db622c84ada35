/* A C program that starts Python through Python FMUs, for test_08_hosts.py.

   python_host LEAVE FOLDER LIBRARY GUID [FOLDER LIBRARY GUID ...]

   Loads each extracted FMU, takes a step, and ends, leaving it as LEAVE says: "running", "freed",
   "unloaded", or "freed_at_exit", by a function that C calls then. */

#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

#define CHECK(condition)                                                                 \
    do {                                                                                 \
        if (!(condition)) {                                                              \
            fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);              \
            exit(1);                                                                     \
        }                                                                                \
    } while (0)

#define FIND(name)                                                                       \
    fmi2##name##TYPE *name;                                                              \
    {                                                                                    \
        void *found = dlsym(library, "fmi2" #name);                                      \
        CHECK(found);                                                                    \
        memcpy(&name, &found, sizeof found);                                             \
    }

static void say(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                fmi2String category, fmi2String message, ...) {
    (void)environment, (void)category;
    fprintf(stderr, "%s: %d %s\n", name, (int)status, message);
}

static struct {
    fmi2FreeInstanceTYPE *free;
    fmi2Component component;
} last; /* freed at exit */

static void free_last(void) { last.free(last.component); }

static const fmi2CallbackFunctions FUNCTIONS = {say, calloc, free, NULL, NULL};

static void step_once(const char *folder, const char *path, const char *guid, const char *leave) {
    char resources[1024];
    CHECK(snprintf(resources, sizeof resources, "file://%s/resources", folder) < 1024);
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) fprintf(stderr, "%s\n", dlerror());
    CHECK(library);
    FIND(Instantiate)
    FIND(SetupExperiment)
    FIND(EnterInitializationMode)
    FIND(ExitInitializationMode)
    FIND(DoStep)
    FIND(FreeInstance)
    int at_exit = strcmp(leave, "freed_at_exit") == 0;
    if (at_exit && !last.free) CHECK(atexit(free_last) == 0); /* before there is an instance */
    fmi2Component c =
        Instantiate("crane", fmi2CoSimulation, guid, resources, &FUNCTIONS, fmi2False, fmi2True);
    CHECK(c);
    CHECK(SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2OK);
    CHECK(EnterInitializationMode(c) == fmi2OK);
    CHECK(ExitInitializationMode(c) == fmi2OK);
    CHECK(DoStep(c, 0.0, 0.005, fmi2True) == fmi2OK);
    if (at_exit) {
        if (last.free) last.free(last.component);
        last.free = FreeInstance;
        last.component = c;
        return;
    }
    if (strcmp(leave, "running") != 0) FreeInstance(c);
    if (strcmp(leave, "unloaded") == 0) dlclose(library);
}

int main(int argc, char **argv) {
    CHECK(argc >= 5);
    for (int fmu = 2; fmu + 2 < argc; fmu += 3)
        step_once(argv[fmu], argv[fmu + 1], argv[fmu + 2], argv[1]);
    printf("done\n");
    return 0;
}
