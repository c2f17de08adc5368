/* Two motions side by side, whose distance grows by the largest Lyapunov exponent. */

#ifndef ZENO_TURNS_H
#define ZENO_TURNS_H

/* `moves` tells what is next: the other motion is placed beside the first, or one of them moves. The
   mode of the first one is `closed` and `sides`. */
typedef struct {
    double turn, distance, vanished; /* time of a turn; distance of both, and its part that is rounding */
    double started;                  /* the distance at the start of a turn */
    double first[ZL_MOST], other[ZL_MOST], direction[ZL_MOST], scale[ZL_MOST];
    long long in_clock[ZL_MOST]; /* whether a state belongs to the clock, and is alike in both */
    long long moves, n_turns, n_rates, closed, sides;
    double *rates; /* the caller's memory: ln(distance / started) / turn of each turn */
} zl_pair;

ZL_EXPORT int zl_turns(const zl_problem *problem, zl_run *run, zl_records *records, zl_pair *pair,
                       long long count);

#endif
