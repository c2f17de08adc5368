/* The library: everything in one unit, so that steps and formulas are compiled together. */

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "loop.h"
#include "tangent.h"
#include "turns.h"
#include "returns.h"

#include "rules.h"

#include "dop853.h"
#include "tape.c"
#include "intervals.c"
#include "formulas.c"
#include "run.h"
#include "fall.c"
#include "guard_net.c"
#include "steps.c"
#include "eigenvalues.c"
#include "leg.c"
#include "zeno.c"
#include "beside.c"
#include "machine.c"
#include "accumulations.c"
#include "graph.c"

long long zl_room(const zl_problem *problem) { return numbers_of(problem); }

long long zl_size(const zl_problem *problem) {
    const zl_graph *graph = problem->graph;
    const long long n = problem->n_p + graph->n_numbers;
    return (long long)(sizeof(zl_run) + (size_t)graph->n_stops * sizeof(zl_settings)) +
           n * (long long)sizeof(double);
}

/* Begin at a state, by the settings and formulas that a run has. */
static void begin_at(const zl_problem *problem, zl_run *run, const double *x) {
    const zl_settings settings = run->settings;
    memset(run, 0, offsetof(zl_run, factors));
    run->settings = settings;
    memcpy(run->start.state, x, (size_t)problem->n_x * sizeof(double));
    run->small_gap = settings.contact * settings.gap;
    run->small_rate = settings.contact * settings.gap_rate;
    run->pace.next_look = FIRST_PACE;
    run->pace.window = INFINITY;
    run->stage = BEFORE;
    run->refused = -1.0;
}

int zl_begin(const zl_problem *problem, zl_run *run, const zl_settings *settings, const double *p,
             const double *x) {
    if (problem->n_x + 2 > ZL_MOST) return ZL_TOO_LARGE;
    run->settings = *settings;
    begin_in_graph(problem, run, settings, p);
    begin_at(problem, run, x);
    return ZL_DONE;
}

int zl_resume(const zl_problem *problem, zl_run *run, zl_records *records) {
    int status = GO_ON;
    Graph g;
    records->n_steps = records->n_polynomials = records->n_arcs = records->n_events = 0;
    enter_graph(&g, problem, run, records);
    while (status == GO_ON) {
        if (run->stage == OVER) return ZL_DONE;
        if (!has_room(&g.m)) return ZL_FULL;
        status = advance_in_graph(&g);
    }
    return status;
}

void zl_answer(zl_run *run, int found, double time, double error, const double *state) {
    run->answered = found;
    run->answer_time = time;
    run->answer_error = error;
    memcpy(run->answer, state, ZL_MOST * sizeof(double));
}

void zl_tell(const zl_run *run, zl_detail *detail) { *detail = run->detail; }

double zl_now(const zl_problem *problem, const zl_run *run, int *mode, double *state) {
    const int in_leg = run->stage == IN_LEG || run->stage == ENDED;
    const double *x = in_leg ? run->leg.y : run->start.state;
    *mode = (int)(in_leg ? run->leg.mode : run->start.mode);
    memcpy(state, x, (size_t)problem->n_x * sizeof(double));
    return in_leg ? run->leg.start_time + run->leg.unit * run->leg.time : run->start.time;
}

/* Take a mode, in a rescaled flight of a speed, without disturbing the leg that a run is in. */
static void enter(const Machine *m, int mode, double speed, Leg *kept) {
    Leg *leg = &m->run->leg;
    *kept = *leg;
    leg->mode = mode;
    leg->n_y = m->problem->n_x + (mode == ZL_FLIGHT ? 2 : 0);
    if (mode == ZL_FLIGHT && m->p[m->problem->n_p] != speed) set_speed(m, speed);
}

static void leave(const Machine *m, const Leg *kept) {
    m->run->leg = *kept;
    if (kept->mode == ZL_FLIGHT && m->p[m->problem->n_p] != kept->unit) set_speed(m, kept->unit);
}

void zl_states_at(const zl_problem *problem, zl_run *run, int mode, double speed,
                  const double *before, const double *offsets, long long count, double *states) {
    const Machine m = machine_of(problem, run, 0);
    double slopes[12][ZL_MOST];
    Leg kept;
    long long row;
    enter(&m, mode, speed, &kept);
    for (row = 0; row < count; row++) {
        const long long at = row * run->leg.n_y;
        rate_at(&m, before + at, slopes[0]);
        explicit_state(&m, before + at, offsets[row], slopes, states + at);
    }
    leave(&m, &kept);
}

/* The end of a flight inside its last step, after which the scaled gap is below zero. */
static int land(const Machine *m, const double *after, double *landing_) {
    const Leg *leg = &m->run->leg;
    const long long n_x = m->problem->n_x;
    double offset = leg->size, y[ZL_MOST], slopes[12][ZL_MOST];
    int close = 0, count;
    memcpy(y, after, sizeof y);
    memcpy(slopes[0], leg->slope, sizeof leg->slope);
    for (count = 0; count < MOST_CORRECTIONS; count++) {
        double change = y[n_x] / y[n_x + 1];
        offset -= change;
        if (offset == leg->size)
            memcpy(y, after, sizeof y);
        else
            explicit_state(m, leg->y, offset, slopes, y);
        if (close) {
            landing_[0] = leg->unit * (leg->time + offset);
            landing_[1] = leg->unit * y[n_x + 1];
            memcpy(landing_ + 2, y, (size_t)n_x * sizeof(double));
            return 1;
        }
        close = fabs(change) <= CLOSE * (leg->time + offset);
    }
    return 0;
}

int zl_flight(const zl_problem *problem, zl_run *run, const double *state, double speed,
              double relative, double absolute, double *landing_) {
    const Machine m = machine_of(problem, run, 0);
    const zl_settings settings = run->settings;
    double y[ZL_MOST], after[ZL_MOST], error;
    Leg kept, *leg = &run->leg;
    long long in_hop;
    int found = 0, count;
    enter(&m, ZL_FLIGHT, speed, &kept);
    memcpy(y, state, (size_t)problem->n_x * sizeof(double));
    y[problem->n_x] = 0.0;
    y[problem->n_x + 1] = 1.0;
    run->settings.begins_explicit = 1;
    in_hop = run->in_hop;
    run->in_hop = 0;
    run->settings.largest_explicit = INFINITY;
    if (begin_leg(&m, ZL_FLIGHT, speed, y, 1e300, relative, absolute)) {
        for (count = 0; count < FLIGHT_STEPS; count++) {
            double growth = EXPLICIT_GROW;
            if (take_explicit(&m, after, &error) != ZL_DONE) break;
            if (!(number_at(&m, ZL_LIFT, after) < 0.0)) break;
            if (after[problem->n_x] <= 0.0) {
                found = land(&m, after, landing_);
                break;
            }
            leg->time += leg->size;
            memcpy(leg->y, after, sizeof after);
            rate_at(&m, leg->y, leg->slope);
            if (error != 0.0) growth = EXPLICIT_SAFETY * pow(error, EXPLICIT_EXPONENT);
            leg->size = next_size(
                leg, lesser(leg->refused ? 1.0 : EXPLICIT_GROW, greater(EXPLICIT_SHRINK, growth)),
                leg->largest_explicit);
            leg->refused = 0;
        }
    }
    run->settings = settings;
    run->in_hop = in_hop;
    leave(&m, &kept);
    return found;
}

void zl_evaluate(const zl_problem *problem, zl_run *run, int tape, const double *varying,
                 double *outputs) {
    const Machine m = machine_of(problem, run, 0);
    if (is_watched(tape))
        intervals_run(&problem->tapes[tape], m.registers[tape], varying, 1, outputs);
    else
        evaluate_at(&m, tape, varying, outputs);
}

void zl_outlook_of(const zl_run *run, zl_outlook *outlook) {
    outlook->rest = run->graph.rest;
    outlook->focus = run->graph.focus;
    outlook->sides = run->graph.sides;
    outlook->above = run->graph.above;
    outlook->splits = run->graph.split_before;
}

void zl_copy(const zl_problem *problem, const zl_run *from, zl_run *to) {
    memcpy(to, from, (size_t)zl_size(problem));
}

#include "turns.c"
#include "tangent.c"
#include "returns.c"
#include "one_leg.c"
#include "check.c"
