/* Guards beside that of the stop which a run looks at, in a machine with several stops or switches.

   The earliest fall of any guard ends a leg. What another guard or an event that may change others
   leads to is the caller's. Where anything is in doubt, the caller follows the arc from its start, by
   the rules of `graph_run` in Python. So doubts cost time, and never an event. */

/* Rounding levels of a guard within which two events may be one. */
#define MARGIN 10.0

static int side_of(const Machine *m) { return m->run->leg.mode == ZL_LOCKED; }

/* A guard and its rate at a state, in the mode off the stop or on it. */
static void pair_beside(const Machine *m, int k, int side, const double *y, double *pair) {
    const zl_guard *guard = &m->problem->beside->guards[k];
    tape_run(&guard->value[side], m->beside + guard->place[side], y, pair);
}

/* The same along the present leg, whose time has its own unit. */
static void pair_in_leg(const Machine *m, int k, const double *y, double *pair) {
    pair_beside(m, k, side_of(m), y, pair);
    pair[1] *= m->run->leg.unit;
}

static void prepare_beside(const Machine *m) {
    const zl_beside *beside = m->problem->beside;
    int k, side;
    if (beside->n_switches)
        tape_prepare(&beside->switches, m->beside + beside->switches_place, m->p);
    tape_prepare(&beside->delassus, m->beside + beside->delassus_place, m->p);
    for (k = 0; k < beside->n_guards; k++)
        for (side = 0; side < 2; side++) {
            const zl_guard *guard = &beside->guards[k];
            tape_prepare(&guard->value[side], m->beside + guard->place[side], m->p);
            intervals_prepare(&guard->bounds[side], m->beside + guard->bounds_place[side], m->p);
        }
}

/* Formulas of all switches at a state, and their rounding levels. */
static void switches_at(const Machine *m, const double *x, double *formulas, double *levels) {
    const zl_beside *beside = m->problem->beside;
    const long long n_x = m->problem->n_x, n = beside->n_switches;
    double given[2 * ZL_MOST], told[3 * ZL_GUARDS];
    long long k;
    if (!n) return;
    for (k = 0; k < n_x; k++) {
        given[k] = x[k];
        given[n_x + k] = m->run->place.sizes[k] + fabs(x[k]);
    }
    tape_run(&beside->switches, m->beside + beside->switches_place, given, told);
    for (k = 0; k < n; k++) {
        formulas[k] = told[k];
        levels[k] = SWITCH_ZERO * told[n + k];
    }
}

/* Take all guards at the start of a leg; 0 unless each is above its rounding, or a switch on zero. */
static int is_clear_at_start(const Machine *m) {
    const zl_beside *beside = m->problem->beside;
    zl_run *run = m->run;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS];
    int k, first = (int)(beside->n_guards - beside->n_switches);
    switches_at(m, run->start.state, formulas, levels);
    for (k = 0; k < beside->n_guards; k++) {
        Watched *watched = &run->watched[k];
        double value;
        /* The caller has not yet built the mode. */
        if (!beside->guards[k].value[side_of(m)].n_outputs) return 0;
        pair_in_leg(m, k, run->leg.y, watched->before);
        value = watched->before[0];
        watched->largest_change = 0.0;
        watched->on_guard = 0;
        watched->rounding = run->place.rounding[k];
        if (k >= first) {
            watched->rounding = levels[k - first];
            value = beside->guards[k].sign * formulas[k - first];
            watched->on_guard = value <= watched->rounding;
            if (watched->on_guard) {
                if (!(value >= -watched->rounding)) return 0;
                continue;
            }
        }
        if (!(value > watched->rounding)) return 0;
    }
    return 1;
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
    const zl_guard *guard = &m->problem->beside->guards[beside->k];
    const int side = side_of(m), n_x = (int)m->problem->n_x, n = (int)m->run->leg.n_y;
    const double unit = m->run->leg.unit;
    double box[2 * ZL_MOST];
    int i;
    box_of_step(beside->step, left, right, box);
    /* The formula knows nothing of the scaled gap of a flight. */
    for (i = 0; i < n_x; i++) box[n_x + i] = box[n + i];
    intervals_run(&guard->bounds[side], m->beside + guard->bounds_place[side], box, all, found);
    for (i = 0; i < 2; i++) {
        found[2 + i] *= unit;
        found[4 + i] *= unit * unit;
    }
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
    if (m->problem->beside->guards[k].bounds[side_of(m)].n_outputs) {
        Net net;
        net.curve = &beside.curve;
        net.is_carried = 0;
        net.state_at = state_beside;
        net.bounds = bounds_beside;
        fall = first_of_all(&net, watched->before, watched->after, step->before, step->after, fall,
                            on_guard, watched->rounding);
    }
    return fall;
}

/* Look at the other guards in a step. The earliest fall before a time ends the leg. */
static int look_beside(Step *step, double until, int is_last) {
    const Machine *m = step->m;
    zl_run *run = m->run;
    Leg *leg = &run->leg;
    const int n = (int)m->problem->beside->n_guards;
    int k;
    run->place.fallen = -1;
    for (k = 0; k < n; k++) {
        Watched *watched = &run->watched[k];
        double fall;
        pair_in_leg(m, k, step->after, watched->after);
        if (!(isfinite(watched->after[0]) && isfinite(watched->after[1]))) return ZL_BESIDE;
        fall = fall_beside(step, k);
        if (!isnan(fall) && leg->time + fall < until) {
            until = leg->time + fall;
            run->fall = fall;
            run->place.fallen = k;
        }
    }
    if (run->place.fallen >= 0) {
        /* A guard that has not risen from its zero may have been left before. */
        for (k = 0; k < n; k++)
            if (k != run->place.fallen && run->watched[k].on_guard && run->watched[k].after[0] < 0.0)
                return ZL_BESIDE;
        leg_end(step, run->fall, leg->end);
        leg->duration = until;
        return LEG_FELL_BESIDE;
    }
    for (k = 0; k < n && !is_last; k++) {
        Watched *watched = &run->watched[k];
        if (watched->on_guard) {
            const double size = step->curve.size;
            double change = greater(watched->largest_change, fabs(watched->before[1]) * size);
            watched->largest_change = greater(change, fabs(watched->after[1]) * size);
            if (watched->after[0] < -greater(LEAVES * watched->largest_change, watched->rounding)) {
                run->place.fallen = k;
                return ZL_OTHER_SIDE;
            }
            watched->on_guard = watched->after[0] <= watched->rounding;
        }
        memcpy(watched->before, watched->after, sizeof watched->before);
    }
    return LEG_GOES_ON;
}

static int is_near_zero(const Machine *m, const double *pair, double rounding) {
    const double near = greater(rounding, -pair[1] * APART * m->run->settings.time);
    return !(pair[1] >= 0.0) && !(pair[0] > MARGIN * near);
}

/* Whether no other guard is about to fall where a leg ends, nor that of the stop if another fell. */
static int ends_alone(const Machine *m) {
    const zl_run *run = m->run;
    const double *end = run->leg.end;
    double pair[2];
    int k;
    for (k = 0; k < m->problem->beside->n_guards; k++) {
        pair_beside(m, k, side_of(m), end, pair);
        if (k != run->place.fallen && is_near_zero(m, pair, run->watched[k].rounding)) return 0;
    }
    if (run->place.fallen < 0) return 1;
    if (side_of(m)) {
        guard_at(m, end, pair);
        return !is_near_zero(m, pair, run->settings.contact * run->settings.multiplier);
    }
    evaluate_at(m, ZL_GAP, end, pair);
    return !is_near_zero(m, pair, run->small_gap);
}

/* The end of an arc at the event of another guard. */
static int ending_beside(const Machine *m) {
    switch (m->problem->beside->guards[m->run->place.fallen].kind) {
    case ZL_OTHER_GAP: return ZL_IMPACT;
    case ZL_OTHER_MULTIPLIER: return ZL_RELEASE;
    default: return ZL_SWITCH;
    }
}

/* Whether an impact leaves all switches on their sides. */
static int keeps_sides(const Machine *m, const double *plus) {
    const zl_beside *beside = m->problem->beside;
    const long long first = beside->n_guards - beside->n_switches;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS];
    long long k;
    switches_at(m, plus, formulas, levels);
    for (k = 0; k < beside->n_switches; k++) {
        const zl_guard *guard = &beside->guards[first + k];
        if (fabs(formulas[k]) <= levels[k]) {
            /* A zero keeps the side of a kink, and counts as positive for a declared switch. */
            if (guard->kind == ZL_DECLARED && guard->sign < 0.0) return 0;
        } else if (!(guard->sign * formulas[k] > 0.0))
            return 0;
    }
    return 1;
}

/* Whether all other closed stops stay closed in an impact: none of them pulls, theory (64). */
static int keeps_closed(const Machine *m, const double *x) {
    const zl_beside *beside = m->problem->beside;
    const long long n_stops = beside->n_stops;
    double all[ZL_GUARDS * ZL_GUARDS], rows[ZL_GUARDS][ZL_GUARDS + 1], small = 0.0;
    long long closed[ZL_GUARDS];
    int n = 0, i, j, k;
    for (k = 0; k < beside->n_guards; k++)
        if (beside->guards[k].kind == ZL_OTHER_MULTIPLIER) closed[n++] = beside->guards[k].stop;
    if (n == 0) return 1;
    tape_run(&beside->delassus, m->beside + beside->delassus_place, x, all);
    for (k = 0; k < n_stops * n_stops; k++) small = greater(small, fabs(all[k]));
    small *= LEAST_IMPULSE;
    for (i = 0; i < n; i++) {
        for (j = 0; j < n; j++) rows[i][j] = all[closed[i] * n_stops + closed[j]];
        rows[i][n] = all[closed[i] * n_stops + beside->stop];
    }
    /* The matrix is positive definite: Gauss's method needs no other order. */
    for (k = 0; k < n; k++)
        for (i = k + 1; i < n; i++) {
            const double factor = rows[i][k] / rows[k][k];
            for (j = k; j <= n; j++) rows[i][j] -= factor * rows[k][j];
        }
    for (i = n - 1; i >= 0; i--) {
        const double size = greater(fabs(all[closed[i] * n_stops + closed[i]]), small);
        for (j = i + 1; j < n; j++) rows[i][n] -= rows[i][j] * rows[j][n];
        rows[i][n] /= rows[i][i];
        if (!(rows[i][n] <= small / size / MARGIN)) return 0;
    }
    return 1;
}

/* Whether the event at the end of a flight is an impact that changes nothing beside its stop, or a
   graze. */
static int strikes_alone(const Machine *m, const double *end) {
    const zl_run *run = m->run;
    const zl_beside *beside = m->problem->beside;
    const long long n_x = m->problem->n_x;
    double gap[2], given[ZL_MOST + 1], landed[3 * ZL_MOST + 2], rate;
    int k;
    if (run->leg.mode == ZL_FLIGHT)
        rate = run->leg.unit * end[n_x + 1];
    else {
        evaluate_at(m, ZL_GAP, end, gap);
        rate = gap[1];
        /* What is touched, not struck, may hold with others. */
        if (!(fabs(rate) > run->small_rate)) return 0;
    }
    if (rate > 0.0) return 1;
    if (!(rate < 0.0)) return 0;
    memcpy(given, end, (size_t)n_x * sizeof(double));
    given[n_x] = rate;
    evaluate_at(m, ZL_LANDING, given, landed);
    if (landed[n_x] < -INSIDE * (run->settings.gap_rate - rate)) return 0;
    if (!keeps_sides(m, landed) || !keeps_closed(m, end)) return 0;
    for (k = 0; k < beside->n_guards; k++)
        if (beside->guards[k].kind == ZL_OTHER_MULTIPLIER) {
            double pair[2];
            pair_beside(m, k, 0, landed, pair);
            if (!(pair[0] > MARGIN * run->watched[k].rounding)) return 0;
        }
    return 1;
}

/* Whether no other guard falls on the way to a Zeno point. */
static int is_clear_at_limit(const Machine *m, const Limit *limit) {
    const zl_beside *beside = m->problem->beside;
    const long long first = beside->n_guards - beside->n_switches;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS], pair[2];
    int k;
    if (limit->time < m->run->place.quiet) return 0;
    switches_at(m, limit->state, formulas, levels);
    for (k = 0; k < beside->n_guards; k++) {
        if (k < first)
            pair_beside(m, k, 0, limit->state, pair);
        else
            pair[0] = beside->guards[k].sign * formulas[k - first] + SPENT * levels[k - first];
        if (!(pair[0] > 0.0)) return 0;
    }
    return 1;
}
