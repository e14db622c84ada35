/* The nonlinear crane's communication step in C99: the same equations as chaincrane/nonlinear.py.

   The NumPy model is the definition; every function here has the name of its Python twin. All
   memory is the caller's: ask chain_memory() for its size, hand it to chain_create() once, and
   nothing is allocated after. There are no globals: two kernels never meet. A step uses + - * / and
   sqrt alone, so that every IEEE machine gives the same digits (compile with -ffp-contract=off).

   Units: m, kg, s, N, J, rad. */

#ifndef CHAIN_KERNEL_H
#define CHAIN_KERNEL_H

#include <stddef.h>

#if defined(CHAIN_STATIC) /* part of a bigger library */
#define CHAIN_API
#elif defined(_WIN32)
#define CHAIN_API __declspec(dllexport)
#else
#define CHAIN_API __attribute__((visibility("default")))
#endif

/* Raised whenever the layout of a struct here, of the state or of the outputs changes. */
enum { CHAIN_KERNEL_VERSION = 3 };

enum { CHAIN_ENERGY_MOMENTUM = 0, CHAIN_NEWMARK = 1 };

enum { CHAIN_CONSISTENT = 0, CHAIN_AVERAGED = 1 };

enum {
    CHAIN_OK = 0,
    CHAIN_NOT_CONVERGED = 1,   /* the iteration for dynamic equilibrium did not converge */
    CHAIN_SINGULAR = 2,        /* newmark: the effective stiffness is singular */
    CHAIN_STEP_ENERGY = 3,     /* a step is off its energy balance */
    CHAIN_TOTAL_ENERGY = 4,    /* the balance since the start is off */
    CHAIN_BAD_VALUE = 5        /* a command or the step size is not allowed */
};

enum { CHAIN_MATERIAL_POINTS = 10, CHAIN_OUTPUTS = 38 };

/* Physics, start and numerical settings, as in chaincrane/parameters.py; the caller checks them. */
typedef struct {
    double length, mass, EA;           /* chain: m, kg, N */
    double payload_mass;               /* kg */
    double gravity;                    /* m/s2 */
    double damping_air, damping_chain; /* 1/s, s */
    double speed, sway_angle;          /* initial: m/s, rad */
    double max_step;                   /* s */
    int elements;
    int scheme;
    int mass_matrix;
} ChainSettings;

/* Why a step failed. */
typedef struct {
    double time;    /* s, where the step that failed began */
    double h;       /* s, its length */
    double defect;  /* J, what the energy balance is off by */
    double scale;   /* J, what that is measured against */
    double allowed; /* of the scale */
} ChainFailure;

typedef struct ChainKernel ChainKernel;

/* CHAIN_KERNEL_VERSION of this build. */
CHAIN_API int chain_version(void);

/* Number of outputs, and bytes of ChainSettings, for a caller to compare with its own. */
CHAIN_API int chain_output_count(void);
CHAIN_API int chain_settings_size(void);

/* Bytes of memory that a kernel of so many elements needs, aligned as doubles are. */
CHAIN_API size_t chain_memory(int elements);

/* Make a kernel in ``memory``, at its initial state. It stays valid while the memory stays put. */
CHAIN_API ChainKernel *chain_create(void *memory, const ChainSettings *settings);

/* Advance by h seconds under held commands. CHAIN_OK, or else the state is as it was before. */
CHAIN_API int chain_step(ChainKernel *kernel, double h, double v_cmd, double a_cmd,
                         double payload_fx, ChainFailure *failure);

/* All outputs in the interface's order, solver.steps and solver.iterations last. */
CHAIN_API void chain_outputs(const ChainKernel *kernel, double outputs[CHAIN_OUTPUTS]);

/* The whole state as one flat array of doubles that may be read, kept and written back. */
CHAIN_API size_t chain_state_count(int elements);
CHAIN_API double *chain_state(ChainKernel *kernel);

#endif
