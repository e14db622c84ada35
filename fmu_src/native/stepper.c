/* The loop of a co-simulation over any FMI 2.0 FMUs, for chaincrane_driver/stepper.py.

   One call does many communication steps of one FMU, or of several that are wired to each other, so
   that no Python runs between the FMI calls. It knows of no crane. Each part sets its inputs, steps
   and reads its outputs into a row of its own tables; a wire takes a value out of such a row. */

#include <stddef.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* Of FMI 2.0, whose value references, Integers and Booleans are 32 bits wide. */
typedef int SetReal(void *, const unsigned *, size_t, const double *);
typedef int GetReal(void *, const unsigned *, size_t, double *);
typedef int GetInteger(void *, const unsigned *, size_t, int *);
typedef int DoStep(void *, double, double, int);
enum { WARNING = 1 }; /* the worst status that a run goes on from */

/* One FMU of a run. A table has a row for each communication point, inputs one for each step. */
typedef struct {
    void *component;
    SetReal *set_real;
    GetReal *get_real;
    GetInteger *get_integer, *get_boolean;
    DoStep *do_step;
    size_t input_count, real_count, integer_count, boolean_count;
    const unsigned *inputs, *reals, *integers, *booleans; /* value references */
    double *input_table, *real_table;
    int *integer_table, *boolean_table;
} Part;

/* A Real output of one part that is an input of another: places of parts, columns of tables. */
typedef struct {
    size_t source, output, sink, input;
} Wire;

/* Where a run ended, if it did before its time. */
typedef struct {
    size_t part;
    int status;
} Stop;

EXPORT size_t stepper_layout(size_t which);
EXPORT int stepper_read(const Part *part, size_t row);
EXPORT size_t stepper_run(Part *parts, size_t part_count, const Wire *wires, size_t wire_count,
                          int sequential, const double *times, const double *sizes, size_t first,
                          size_t last, Stop *stop);

/* Sizes of the structures, for stepper.py to compare with its own. */
size_t stepper_layout(size_t which) {
    const size_t sizes[] = {sizeof(Part), sizeof(Wire), sizeof(Stop)};
    return sizes[which];
}

/* The worse of two statuses. */
static int worse(int one, int other) { return one > other ? one : other; }

/* Read a part's outputs into a row of its tables; the worst status of the calls. */
int stepper_read(const Part *p, size_t row) {
    int status = 0;
    if (p->real_count)
        status = worse(status, p->get_real(p->component, p->reals, p->real_count,
                                           p->real_table + row * p->real_count));
    if (p->integer_count)
        status = worse(status, p->get_integer(p->component, p->integers, p->integer_count,
                                              p->integer_table + row * p->integer_count));
    if (p->boolean_count)
        status = worse(status, p->get_boolean(p->component, p->booleans, p->boolean_count,
                                              p->boolean_table + row * p->boolean_count));
    return status;
}

/* Set a part's inputs of a step, where they are not those of the step before. */
static int set_inputs(const Part *p, size_t step, size_t first) {
    const size_t bytes = p->input_count * sizeof(double);
    const double *row = p->input_table + step * p->input_count;
    if (!bytes || (step > first && memcmp(row, row - p->input_count, bytes) == 0)) return 0;
    return p->set_real(p->component, p->inputs, p->input_count, row);
}

/* Do the steps `first` to `last` - 1, each from times[i] over sizes[i]; how many were done, and in
   `stop` why no more. `sequential`: a part sees what those before it gave in this very step; else
   what all gave at its start. */
size_t stepper_run(Part *parts, size_t part_count, const Wire *wires, size_t wire_count,
                   int sequential, const double *times, const double *sizes, size_t first,
                   size_t last, Stop *stop) {
    for (size_t i = first; i < last; i++) {
        for (size_t n = 0; n < part_count; n++) {
            Part *p = &parts[n];
            for (size_t k = 0; k < wire_count; k++) {
                const Wire *w = &wires[k];
                if (w->sink != n) continue;
                const Part *source = &parts[w->source];
                size_t row = sequential && w->source < n ? i + 1 : i;
                p->input_table[i * p->input_count + w->input] =
                    source->real_table[row * source->real_count + w->output];
            }
            int status = set_inputs(p, i, first);
            if (status <= WARNING)
                status = worse(status, p->do_step(p->component, times[i], sizes[i], 1));
            if (status <= WARNING) status = worse(status, stepper_read(p, i + 1));
            if (status > WARNING) {
                stop->part = n;
                stop->status = status;
                return i - first;
            }
        }
    }
    return last - first;
}
