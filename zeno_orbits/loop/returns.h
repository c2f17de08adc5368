/* A periodic orbit near a state after an event of the only stop, by Newton's method. */

#ifndef ZENO_RETURNS_H
#define ZENO_RETURNS_H

/* The first part is given: `section` is a kind of event, after `n_returns` of which a motion is back,
   `guess` about the time of that, and `exact` the largest relative correction of an orbit. The start
   is replaced by that of the last return. Rows of `shifts` are as of `zl_follow`, three an arc. */
typedef struct {
    double guess, exact, trusted;
    double start[ZL_MOST], sizes[ZL_MOST];
    long long section, n_returns;
    const zl_settings *settings;
    const double *p;
    double *shifts, *work;
    double period, end[ZL_MOST], scale[ZL_MOST];
    double by_state[ZL_MOST * ZL_MOST]; /* derivative of the end, by rows of n_x */
    long long n_arcs, n_events;         /* up to the end of the return, or the contact after it */
} zl_closing;

enum {
    ZL_CLOSED, /* it repeats */
    ZL_OPEN,   /* there is no orbit nearby */
    ZL_ASKS    /* the reference has to look for it */
};

/* Close the return. `run` carries out the motion of `problem`, and
   `other` has the formulas of `view`, its only one, of which `tangent` has the derivatives. */
ZL_EXPORT int zl_close(const zl_problem *problem, zl_run *run, const zl_problem *view,
                       const zl_tangent *tangent, zl_run *other, zl_records *records,
                       zl_closing *closing);

#endif
