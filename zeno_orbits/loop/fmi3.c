/* A problem as a co-simulation unit of FMI 3.0: it integrates, and passes impacts, Zeno points and
   releases by itself.

       cc -std=c99 -O2 -ffp-contract=off -fPIC -shared fmi3.c -lm -o PROBLEM.so

   These functions and those of `fmi3_calls.c` are what its description offers; `fmi3_refused.c` has all
   others. */

#include <stdio.h>

#include "PROBLEM.c"
#include "fmi3_head.c"
#include "fmi3_unit.c"

#define AT(unit) ((unit)->reached)

API int fmi3GetInt32(void *instance, const uint32_t refs[], size_t n, int32_t values[], size_t m);

/* Everything as it is after instantiation. */
static void set_up(Unit *unit) {
    Reached *reached = &unit->reached;
    int k;
    memset(reached, 0, sizeof *reached);
    memcpy(unit->p, PROBLEM_parameters, (size_t)problem->n_p * sizeof(double));
    memcpy(reached->state, PROBLEM_start, (size_t)problem->n_x * sizeof(double));
    reached->relative = PROBLEM_settings[0].relative;
    reached->zeno_time = NAN;
    for (k = 0; k < ZL_STOPS; k++) reached->zeno_times[k] = NAN;
    reached->stop = 1e300;
}

static Unit *new_unit(void) {
    Unit *unit = calloc(1, sizeof *unit);
    zl_records *records;
    if (!unit) return 0;
    records = &unit->records;
    records->most_arcs = records->most_events = ROOM;
    records->most_estimates = ESTIMATES;
    records->arcs = malloc(ROOM * (ZL_ARC_WIDTH + 2 * ZL_MOST) * sizeof(double));
    records->events = malloc(ROOM * (ZL_EVENT_WIDTH + 2 * ZL_MOST) * sizeof(double));
    records->estimates = malloc(estimates_size(ESTIMATES));
    unit->run = calloc(1, run_size());
    unit->p = calloc(1, p_size());
    if (more_steps(unit, ROOM) && records->arcs && records->events &&
        records->estimates && unit->run && unit->p)
        return unit;
    fmi3FreeInstance(unit);
    return 0;
}

void fmi3FreeInstance(void *instance) {
    Unit *unit = instance;
    if (!unit) return;
    free(unit->records.steps);
    free(unit->records.polynomials);
    free(unit->records.arcs);
    free(unit->records.events);
    free(unit->records.estimates);
    free(unit->run);
    free(unit->p);
    free(unit);
}

static void take_tolerance(Unit *unit, double relative) { unit->reached.relative = relative; }

static int step_to(Unit *unit, double begin, double end) {
    (void)begin;
    return go_to(unit, end);
}

#include "fmi3_calls.c"

/* The first states are those after whatever happens at the start: an impact, say. */
int fmi3ExitInitializationMode(void *instance) {
    Unit *unit = instance;
    if (unit->reached.stage != INITIALIZATION) return fail(unit, "The unit is not initialized");
    if (require_clock(unit) != OK) return ERROR;
    unit->reached.stage = STEPS;
    return go_to(unit, unit->reached.time);
}

int fmi3GetFloat64(void *instance, const uint32_t refs[], size_t n, double values[], size_t m) {
    const Unit *unit = instance;
    const Reached *reached = &unit->reached;
    const uint32_t n_x = (uint32_t)problem->n_x, n_p = (uint32_t)problem->n_p;
    int stop = 0;
    size_t k;
    if (n != m) return fail(unit, "Every variable has one value");
    for (k = 0; k < n; k++) {
        const uint32_t ref = refs[k];
        if (ref == 0)
            values[k] = reached->time;
        else if (ref <= n_x)
            values[k] = reached->state[ref - 1];
        else if (ref <= n_x + n_p)
            values[k] = unit->p[ref - 1 - n_x];
        else if (ref == n_x + n_p + 1 + ZENO_TIME)
            values[k] = reached->zeno_time;
        else if (of_stop(ref, &stop) == ZENO_TIME)
            values[k] = reached->zeno_times[stop];
        else
            return fail(unit, "There is no such variable of type Float64");
    }
    return OK;
}

int fmi3SetFloat64(void *instance, const uint32_t refs[], size_t n, const double values[],
                   size_t m) {
    Unit *unit = instance;
    Reached *reached = &unit->reached;
    const uint32_t n_x = (uint32_t)problem->n_x, n_p = (uint32_t)problem->n_p;
    size_t k;
    if (n != m) return fail(unit, "Every variable has one value");
    /* A call that is refused changes nothing. */
    for (k = 0; k < n; k++) {
        const uint32_t ref = refs[k];
        const int is_parameter = ref > n_x && ref <= n_x + n_p;
        if (!(ref >= 1 && ref <= n_x) && !is_parameter)
            return fail(unit, "The variable cannot be set");
        if (!isfinite(values[k])) return fail(unit, "A value must be finite");
        if (reached->stage > INITIALIZATION && !(is_parameter && MAY_CHANGE[ref - 1 - n_x]))
            return fail(unit, "The variable cannot be set after initialization");
        if (is_parameter && !is_in_range(ref - 1 - n_x, values[k]))
            return fail_in_range(unit, ref - 1 - n_x, values[k]);
    }
    for (k = 0; k < n; k++) {
        const uint32_t ref = refs[k], at = ref - 1 - n_x;
        if (ref <= n_x) {
            reached->state[ref - 1] = values[k];
            continue;
        }
        reached->given[at] = 1;
        if (unit->p[at] == values[k]) continue;
        unit->p[at] = values[k];
        reached->changed = 1;
    }
    return OK;
}

int fmi3GetInt32(void *instance, const uint32_t refs[], size_t n, int32_t values[], size_t m) {
    const Unit *unit = instance;
    const Reached *reached = &unit->reached;
    const uint32_t first = (uint32_t)(1 + problem->n_x + problem->n_p);
    int stop = 0;
    size_t k;
    if (n != m) return fail(unit, "Every variable has one value");
    for (k = 0; k < n; k++) {
        if (refs[k] == first + MODE)
            values[k] = reached->mode;
        else if (refs[k] == first + IMPACTS)
            values[k] = (int32_t)reached->impacts;
        else if (refs[k] == first + ZENO_POINTS)
            values[k] = (int32_t)reached->zeno_points;
        else if (of_stop(refs[k], &stop) == IMPACTS)
            values[k] = (int32_t)reached->stop_impacts[stop];
        else if (of_stop(refs[k], &stop) == ZENO_POINTS)
            values[k] = (int32_t)reached->stop_zeno_points[stop];
        else
            return fail(unit, "There is no such variable of type Int32");
    }
    return OK;
}

/* Write all that a unit has reached into another. */
static int copied(const Unit *from, Unit *to) {
    while (to->records.most_estimates < from->records.most_estimates)
        if (!more_estimates(to)) return ERROR;
    memcpy(to->records.estimates, from->records.estimates,
           estimates_size(from->records.most_estimates));
    if (to->records.most_steps < from->records.most_steps &&
        !more_steps(to, from->records.most_steps))
        return ERROR;
    memcpy(to->records.steps, from->records.steps, steps_size(from->records.n_steps));
    memcpy(to->records.polynomials, from->records.polynomials,
           polynomials_size(from->records.n_polynomials));
    to->records.n_steps = from->records.n_steps;
    to->records.n_polynomials = from->records.n_polynomials;
    to->reached = from->reached;
    memcpy(to->run, from->run, run_size());
    memcpy(to->p, from->p, p_size());
    return OK;
}

int fmi3GetFMUState(void *instance, void **kept) {
    const Unit *unit = instance;
    if (!*kept) *kept = new_unit();
    return *kept ? copied(unit, *kept) : fail(unit, "There is no memory");
}

int fmi3SetFMUState(void *instance, void *kept) { return copied(kept, instance); }

int fmi3FreeFMUState(void *instance, void **kept) {
    (void)instance;
    fmi3FreeInstance(*kept);
    *kept = 0;
    return OK;
}

#include "fmi3_refused.c"
