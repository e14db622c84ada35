/* A host's times; see clock.h. */

#include "clock.h"

#include <math.h>

#include "twins.h"

/* A tolerance in time, s, but never so much that a step could be left out or done twice. */
static double within(double tolerance, double h) {
    return 0.0 < 0.5 * h && 0.5 * h < tolerance ? 0.5 * h : tolerance;
}

int is_now(double at, double reached, double h) {
    return fabs(at - reached) <= within(TIME_TOLERANCE + TIME_ROUND_OFF * fabs(reached), h);
}

int is_beyond(double end, double stop, double h) {
    double time = fabs(stop) > 1.0 ? fabs(stop) : 1.0;
    return end > stop + within(TIME_TOLERANCE * time, h);
}

double meant_step(double at, double h, double unit) {
    double ratio = h / unit + 0.5;
    if (!(ratio >= 1.0 && ratio - ratio == 0.0)) return h;
    double whole = floor(ratio) * unit;
    return fabs(h - whole) <= TIME_ROUND_OFF * (fabs(at) + h) ? whole : h;
}
