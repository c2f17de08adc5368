/* Guards beside that of the stop which a run looks at: of other stops and of switches.

   The earliest fall of any guard ends an arc: `ReferenceRun._earliest` in Python. As a rule a leg ends
   where the first guard falls in a step. Where a guard begins on its zero, or below, every guard is
   followed to its own end, and `graph.c` decides as Python does. */

enum { NO_FALL, FELL, IS_LEFT };

/* A guard and its rate along the present leg, whose time has its own unit. */
static void pair_in_leg(const Machine *m, int k, const double *y, double *pair) {
    const Other *other = &m->others->list[k];
    tape_run(other->value, other->registers, y, pair);
    pair[1] *= m->run->leg.unit;
}

/* A guard in a step. */
typedef struct {
    Curve curve;
    Step *step;
    int k;
} Beside;

static void look_at_beside(const Curve *curve, int kind, double offset, double *pair) {
    const Beside *beside = (const Beside *)(const void *)curve;
    double state[ZL_MOST];
    if (kind == TRUE_END)
        true_end(beside->step, offset, state, pair);
    else
        dense(beside->step, offset, state, pair);
    pair_in_leg(beside->step->m, beside->k, state, pair);
}

static void state_beside(const Curve *curve, double offset, double *state, double *pair) {
    const Beside *beside = (const Beside *)(const void *)curve;
    dense(beside->step, offset, state, pair);
    pair_in_leg(beside->step->m, beside->k, state, pair);
}

static void bounds_beside(const Curve *curve, const Place *left, const Place *right, int all,
                          double *found) {
    const Beside *beside = (const Beside *)(const void *)curve;
    const Machine *m = beside->step->m;
    const Other *other = &m->others->list[beside->k];
    const int n_x = (int)m->problem->n_x, n = (int)m->run->leg.n_y;
    const double unit = m->run->leg.unit;
    double box[2 * ZL_MOST];
    int i;
    box_of_step(beside->step, left, right, box);
    /* The formula knows nothing of the scaled gap of a flight. */
    for (i = 0; i < n_x; i++) box[n_x + i] = box[n + i];
    intervals_run(other->bounds, other->bounds_registers, box, all, found);
    for (i = 0; i < 2; i++) {
        found[2 + i] *= unit;
        found[4 + i] *= unit * unit;
    }
}

/* Whether a guard that rose from its root falls to zero just where the step ends. */
static int is_back(const Watched *watched, double size) {
    return watched->before[1] * size > watched->rounding &&
           fabs(watched->after[0]) <= watched->rounding && watched->after[1] < 0.0;
}

/* Where in a step a guard first falls; NaN if it does not. As `leg_fall`. */
static double fall_beside(Step *step, int k) {
    const Machine *m = step->m;
    const Leg *leg = &m->run->leg;
    const Watched *watched = &m->run->watched[k];
    const int on_guard = (int)watched->on_guard;
    double fall;
    Beside beside;
    beside.curve.look = look_at_beside;
    beside.curve.size = step->curve.size;
    beside.curve.exact = 0;
    beside.step = step;
    beside.k = k;
    fall = first_fall(&beside.curve, watched->before, watched->after, on_guard);
    if (!isnan(fall) && on_guard) {
        double state[ZL_MOST], pair[2];
        leg_end(step, fall, state);
        pair_in_leg(m, k, state, pair);
        if (fabs(pair[1]) * (leg->time + fall) < watched->rounding) fall = NAN;
    }
    if (m->others->list[k].bounds->n_outputs) {
        Net net;
        net.curve = &beside.curve;
        net.is_carried = 0;
        net.returns = m->others->list[k].kind == ZL_SWITCH;
        net.state_at = state_beside;
        net.bounds = bounds_beside;
        fall = first_of_all(&net, watched->before, watched->after, step->before, step->after, fall,
                            on_guard, watched->rounding);
        if (isnan(fall) && net.returns && on_guard && is_back(watched, step->curve.size))
            fall = step->curve.size;
    }
    return fall;
}

static void end_of_guard(Step *step, int k, int outcome, double fall) {
    const Leg *leg = &step->m->run->leg;
    Watched *watched = &step->m->run->watched[k];
    watched->outcome = outcome;
    watched->n_steps = leg->n_steps;
    watched->n_polynomials = leg->n_polynomials;
    watched->until = leg->time + step->curve.size;
    if (outcome == FELL) {
        watched->at = leg->time + fall;
        leg_end(step, fall, watched->end);
    } else {
        watched->at = leg->time;
        memcpy(watched->end, step->before, sizeof watched->end);
    }
}

/* Go over to the next step; 1 if the guard was left on its wrong side. */
static int passes(Watched *watched, double size) {
    if (watched->on_guard) {
        double change = greater(watched->largest_change, fabs(watched->before[1]) * size);
        watched->largest_change = greater(change, fabs(watched->after[1]) * size);
        if (watched->after[0] < -greater(LEAVES * watched->largest_change, watched->rounding))
            return 1;
        watched->on_guard = watched->after[0] <= watched->rounding;
    }
    memcpy(watched->before, watched->after, sizeof watched->before);
    return 0;
}

/* Follow every guard through a step to its own end. */
static int follow_all(Step *step) {
    const Machine *m = step->m;
    int k;
    for (k = 0; k < m->others->n; k++) {
        Watched *watched = &m->run->watched[k];
        double fall;
        if (watched->outcome != NO_FALL || watched->launched > 0.0) continue;
        pair_in_leg(m, k, step->after, watched->after);
        fall = fall_beside(step, k);
        if (!isnan(fall))
            end_of_guard(step, k, FELL, fall);
        else if (passes(watched, step->curve.size))
            end_of_guard(step, k, IS_LEFT, 0.0);
    }
    return LEG_GOES_ON;
}

/* Whether a guard that has not risen from its zero may have been left before the leg ends. */
static int may_be_left(const Machine *m, const double *end, int found) {
    const zl_run *run = m->run;
    int k;
    for (k = 0; k < m->others->n; k++) {
        double pair[2];
        if (k == found || !run->watched[k].on_guard) continue;
        pair_in_leg(m, k, end, pair);
        if (run->watched[k].after[0] < 0.0 || pair[0] < 0.0) return 1;
    }
    return 0;
}

/* Look at the other guards in a step. The earliest fall before a time ends the leg. Where anything is
   in doubt, every guard has to be followed: LEG_IN_DOUBT. */
static int look_beside(Step *step, double until, int is_last) {
    const Machine *m = step->m;
    zl_run *run = m->run;
    Leg *leg = &run->leg;
    const int n = m->others->n;
    int k, found = -1;
    if (run->graph.careful) return follow_all(step);
    for (k = 0; k < n; k++) {
        Watched *watched = &run->watched[k];
        double fall;
        pair_in_leg(m, k, step->after, watched->after);
        if (!(isfinite(watched->after[0]) && isfinite(watched->after[1]))) return LEG_IN_DOUBT;
        fall = fall_beside(step, k);
        if (!isnan(fall) && leg->time + fall < until) {
            until = leg->time + fall;
            end_of_guard(step, k, FELL, fall);
            found = k;
        }
    }
    if (found >= 0) {
        if (may_be_left(m, run->watched[found].end, found)) return LEG_IN_DOUBT;
        run->graph.found = found;
        return LEG_FELL_BESIDE;
    }
    if (is_last) return may_be_left(m, leg->end, -1) ? LEG_IN_DOUBT : LEG_GOES_ON;
    for (k = 0; k < n; k++)
        if (passes(&run->watched[k], step->curve.size)) {
            const int is_clear = !leg->on_guard || step->guard_after[0] > leg->rounding;
            if (m->others->list[k].kind != ZL_SWITCH || !is_clear) return LEG_IN_DOUBT;
            found = k;
            end_of_guard(step, k, IS_LEFT, 0.0);
        }
    if (found < 0) return LEG_GOES_ON;
    /* A switch on its wrong side ends the leg, unless another guard may have been left as well. */
    for (k = 0; k < n; k++)
        if (k != found && run->watched[k].on_guard) return LEG_IN_DOUBT;
    run->graph.found = found;
    return LEG_FELL_BESIDE;
}
