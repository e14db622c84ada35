/* Both native FMUs in one program, compiled with FMI2_FUNCTION_PREFIX, for test_08_native.py: prints
   payload.x_rel of each after half a second. */

#include <stdio.h>
#include <stdlib.h>

#include "fmi2FunctionTypes.h"
#include "interface.h"

/* An FMU by its prefix: payload.x_rel at 0.5 s. */
#define RUN(PREFIX, GUID)                                                                \
    fmi2InstantiateTYPE PREFIX##fmi2Instantiate;                                         \
    fmi2SetupExperimentTYPE PREFIX##fmi2SetupExperiment;                                 \
    fmi2EnterInitializationModeTYPE PREFIX##fmi2EnterInitializationMode;                 \
    fmi2ExitInitializationModeTYPE PREFIX##fmi2ExitInitializationMode;                   \
    fmi2DoStepTYPE PREFIX##fmi2DoStep;                                                   \
    fmi2GetRealTYPE PREFIX##fmi2GetReal;                                                 \
    fmi2FreeInstanceTYPE PREFIX##fmi2FreeInstance;                                       \
    static double PREFIX##run(void) {                                                    \
        const fmi2ValueReference seen = VR_PAYLOAD_X_REL;                                \
        double x = 0.0;                                                                  \
        fmi2CallbackFunctions functions = {quiet, calloc, free, NULL, NULL};             \
        fmi2Component c = PREFIX##fmi2Instantiate("crane", fmi2CoSimulation, GUID, "",   \
                                                  &functions, fmi2False, fmi2False);     \
        if (!c) exit(1);                                                                 \
        PREFIX##fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0);             \
        PREFIX##fmi2EnterInitializationMode(c);                                          \
        PREFIX##fmi2ExitInitializationMode(c);                                           \
        if (PREFIX##fmi2DoStep(c, 0.0, 0.5, fmi2True) != fmi2OK) exit(1);                \
        if (PREFIX##fmi2GetReal(c, &seen, 1, &x) != fmi2OK) exit(1);                     \
        PREFIX##fmi2FreeInstance(c);                                                     \
        return x;                                                                        \
    }

static void quiet(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                  fmi2String category, fmi2String message, ...) {
    (void)environment, (void)name, (void)status, (void)category, (void)message;
}

RUN(crane_nl_native_, NL_GUID)
RUN(crane_lin_native_, LIN_GUID)

int main(void) {
    printf("%.17g %.17g\n", crane_nl_native_run(), crane_lin_native_run());
    return 0;
}
