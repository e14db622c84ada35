/* A C program that starts Python by running a Python FMU, for test_08_hosts.py.

   python_host LEAVE FOLDER LIBRARY GUID

   Loads the extracted FMU, takes a step, and ends, leaving it as LEAVE says: "running", "freed",
   "unloaded", or "freed_at_exit", by a function that C calls then. */

#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "check.h"
#include "fmi2FunctionTypes.h"

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

static fmi2FreeInstanceTYPE *free_instance;
static fmi2Component crane;

static void free_crane(void) { free_instance(crane); }

static const fmi2CallbackFunctions FUNCTIONS = {say, calloc, free, NULL, NULL};

int main(int argc, char **argv) {
    CHECK(argc == 5);
    const char *leave = argv[1], *folder = argv[2], *guid = argv[4];
    char resources[1024];
    CHECK(snprintf(resources, sizeof resources, "file://%s/resources", folder) < 1024);
    void *library = dlopen(argv[3], RTLD_NOW | RTLD_LOCAL);
    if (!library) fprintf(stderr, "%s\n", dlerror());
    CHECK(library);
    FIND(Instantiate)
    FIND(SetupExperiment)
    FIND(EnterInitializationMode)
    FIND(ExitInitializationMode)
    FIND(DoStep)
    FIND(FreeInstance)
    free_instance = FreeInstance;
    if (strcmp(leave, "freed_at_exit") == 0) CHECK(atexit(free_crane) == 0); /* older than crane */
    crane =
        Instantiate("crane", fmi2CoSimulation, guid, resources, &FUNCTIONS, fmi2False, fmi2True);
    CHECK(crane);
    CHECK(SetupExperiment(crane, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2OK);
    CHECK(EnterInitializationMode(crane) == fmi2OK);
    CHECK(ExitInitializationMode(crane) == fmi2OK);
    CHECK(DoStep(crane, 0.0, 0.005, fmi2True) == fmi2OK);
    if (strcmp(leave, "freed") == 0 || strcmp(leave, "unloaded") == 0) FreeInstance(crane);
    if (strcmp(leave, "unloaded") == 0) dlclose(library);
    printf("done\n");
    return 0;
}
