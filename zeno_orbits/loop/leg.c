/* One leg: steps of a mode until its guard falls, as `events` and `automatic` in Python have them. */

typedef struct {
    Curve curve;
    const Machine *m;
    const double *before, *slope, *after, *slope_after, *guard_after;
    const double *coefficients; /* of an implicit step, else null */
    double ended[1 + ZL_MOST];  /* where the last implicit step from its start ended, and how */
} Step;

/* The state inside a step as dense output has it, and the guard there. */
static void dense(const Step *step, double offset, double *state, double *pair) {
    const int n = (int)step->m->run->leg.n_y;
    int i;
    if (offset == step->curve.size) {
        memcpy(state, step->after, (size_t)n * sizeof(double));
        pair[0] = step->guard_after[0];
        pair[1] = step->guard_after[1];
        return;
    }
    if (step->coefficients) {
        double value[ZL_MOST];
        polynomial_at(step->coefficients, n, offset / step->curve.size, value);
        for (i = 0; i < n; i++) state[i] = step->before[i] + value[i];
    } else {
        double slopes[12][ZL_MOST];
        memcpy(slopes[0], step->slope, (size_t)n * sizeof(double));
        explicit_state(step->m, step->before, offset, slopes, state);
    }
    guard_at(step->m, state, pair);
}

/* The same after a true step that ends inside a step; dense output where there is none. */
static void true_end(Step *step, double offset, double *state, double *pair) {
    const size_t bytes = (size_t)step->m->run->leg.n_y * sizeof(double);
    Found found;
    if (step->coefficients && 0.0 < offset && offset < step->curve.size &&
        implicit_step(step->m, step->before, step->slope, offset, step->coefficients, 0.0,
                      offset / step->curve.size, &found)) {
        memcpy(state, found.after, bytes);
        pair[0] = found.guard[0];
        pair[1] = found.guard[1];
        step->ended[0] = offset;
        memcpy(step->ended + 1, found.after, bytes);
        return;
    }
    dense(step, offset, state, pair);
}

/* The guard inside a step, as `fall.c` asks for it. */
static void look_inside(const Curve *curve, int kind, double offset, double *pair) {
    double state[ZL_MOST];
    Step *step = (Step *)(void *)(uintptr_t)(const void *)curve;
    if (kind == TRUE_END)
        true_end(step, offset, state, pair);
    else
        dense(step, offset, state, pair);
}

/* The state at the end of a leg. From so near a true end a tangent is right to rounding. */
static void leg_end(Step *step, double offset, double *state) {
    const int n = (int)step->m->run->leg.n_y;
    double shift = offset - step->ended[0], slope[ZL_MOST], pair[2];
    int i;
    if (!(fabs(shift) <= DOUBLES * step->curve.size)) {
        true_end(step, offset, state, pair);
        return;
    }
    rate_at(step->m, step->ended + 1, slope);
    for (i = 0; i < n; i++) state[i] = step->ended[1 + i] + shift * slope[i];
}

/* Whether the guard, from its root at the start of the leg, has not risen above rounding. */
static int is_rounding(Step *step, double fall) {
    const Leg *leg = &step->m->run->leg;
    double state[ZL_MOST], pair[2];
    leg_end(step, fall, state);
    guard_at(step->m, state, pair);
    return fabs(pair[1]) * (leg->time + fall) < leg->rounding;
}

/* Move the ends of a box outwards by the rounding of formulas in it. */
static void widen(double *box, int n) {
    int i;
    for (i = 0; i < n; i++) {
        box[i] -= ROUNDED * fabs(box[i]);
        box[n + i] += ROUNDED * fabs(box[n + i]);
    }
}

/* Bounds of the states of an implicit step between two places, from its polynomial. */
static void box_of_polynomial(const Step *step, const Place *left, const Place *right,
                              double *box) {
    const int n = (int)step->m->run->leg.n_y;
    const double start = left->offset / step->curve.size;
    const double part = (right->offset - left->offset) / step->curve.size;
    int i, k, j;
    for (i = 0; i < n; i++) {
        /* Taylor's shift to the piece, then Bernstein's coefficients on it, by differences. */
        double a[ZL_STAGES + 1], scale = 1.0;
        a[0] = step->before[i];
        for (k = 0; k < ZL_STAGES; k++) a[k + 1] = step->coefficients[k * n + i];
        if (start > 0.0)
            for (k = 0; k < ZL_STAGES; k++)
                for (j = ZL_STAGES - 1; j >= k; j--) a[j] += start * a[j + 1];
        for (k = 1; k <= ZL_STAGES; k++) {
            scale *= part * k / (ZL_STAGES - k + 1);
            a[k] *= scale;
        }
        for (k = 1; k <= ZL_STAGES; k++)
            for (j = ZL_STAGES; j >= k; j--) a[j] += a[j - 1];
        box[i] = box[n + i] = a[0];
        for (k = 1; k <= ZL_STAGES; k++) {
            box[i] = lesser(box[i], a[k]);
            box[n + i] = greater(box[n + i], a[k]);
        }
    }
}

/* The same of an explicit step: of the cubic through both, widened, as it is not the flow itself. */
static void box_of_cubic(const Step *step, const Place *left, const Place *right, double *box) {
    const int n = (int)step->m->run->leg.n_y;
    const double third = (right->offset - left->offset) / 3;
    double rates[2][ZL_MOST];
    const double *low_rate = rates[0], *high_rate = rates[1];
    int i;
    if (left->offset == 0.0)
        low_rate = step->slope;
    else
        rate_at(step->m, left->state, rates[0]);
    if (right->offset == step->curve.size)
        high_rate = step->slope_after;
    else
        rate_at(step->m, right->state, rates[1]);
    for (i = 0; i < n; i++) {
        double low = left->state[i], high = right->state[i];
        double inner = low + third * low_rate[i], outer = high - third * high_rate[i];
        double lower = lesser(lesser(low, high), lesser(inner, outer));
        double upper = greater(greater(low, high), greater(inner, outer));
        double slack = SLACK * (upper - lower);
        box[i] = lower - slack;
        box[n + i] = upper + slack;
    }
}

static void box_of_step(const Step *step, const Place *left, const Place *right, double *box) {
    if (step->coefficients)
        box_of_polynomial(step, left, right, box);
    else
        box_of_cubic(step, left, right, box);
    widen(box, (int)step->m->run->leg.n_y);
}

static void bounds_between(const Curve *curve, const Place *left, const Place *right, int all,
                           double *found) {
    const Step *step = (const Step *)(const void *)curve;
    const int watched = ZL_WATCHED + (int)step->m->run->leg.mode;
    double box[2 * ZL_MOST];
    box_of_step(step, left, right, box);
    intervals_run(&step->m->problem->tapes[watched], step->m->registers[watched], box, all, found);
}

static void state_inside(const Curve *curve, double offset, double *state, double *pair) {
    dense((const Step *)(const void *)curve, offset, state, pair);
}

/* Where in a step the guard of a leg first falls; NaN if it does not. */
static double leg_fall(Step *step, const double *before, const double *after) {
    const Leg *leg = &step->m->run->leg;
    const int on_guard = (int)leg->on_guard;
    double fall = first_fall(&step->curve, before, after, on_guard);
    if (!isnan(fall) && on_guard && is_rounding(step, fall)) fall = NAN;
    if (step->m->problem->tapes[ZL_WATCHED + leg->mode].n_outputs) {
        Net net;
        net.curve = &step->curve;
        /* In a hop its formula is rounding. */
        net.is_carried = step->m->problem->carried[leg->mode] && !step->m->run->in_hop;
        net.returns = 0;
        net.state_at = state_inside;
        net.bounds = bounds_between;
        fall = first_of_all(&net, before, after, step->before, step->after, fall, on_guard,
                            leg->rounding);
    }
    return fall;
}

/* The largest rate of what does not decay long before a leg ends. */
static double staying_rate(const Leg *leg, double left) {
    double largest = 0.0;
    int i;
    for (i = 0; i < leg->n_y; i++) {
        double real = leg->rates[i], imaginary = leg->rates[ZL_MOST + i];
        if (!(real < -fabs(imaginary) && -real * left > LONG_LEFT))
            largest = greater(largest, hypot(real, imaginary));
    }
    return largest;
}

/* Look at the rates of a flow: what holds explicit steps back, and an implicit step to begin with.
   Where the Jacobian is not finite nothing is told, and explicit steps soon come to their end. */
static void look_at_rates(const Machine *m, const double *y) {
    Leg *leg = &m->run->leg;
    const int n = (int)leg->n_y;
    double columns[ZL_MOST * ZL_MOST], rows[ZL_MOST][ZL_MOST], fastest = 0.0, next = 0.0, lowest;
    int i, j, known = 1;
    jacobian_at(m, y, columns);
    for (i = 0; i < n; i++)
        for (j = 0; j < n; j++) {
            rows[i][j] = columns[j * n + i];
            known = known && isfinite(rows[i][j]);
        }
    leg->fastest = leg->first = 0.0;
    if (!known || !eigenvalues(n, rows, leg->rates, leg->rates + ZL_MOST)) {
        memset(leg->rates, 0, sizeof leg->rates);
        return;
    }
    lowest = leg->rates[0];
    for (i = 1; i < n; i++) lowest = lesser(lowest, leg->rates[i]);
    fastest = greater(-lowest, 0.0);
    for (i = 0; i < n; i++)
        if (-leg->rates[i] < fastest / 10)
            next = greater(next, hypot(leg->rates[i], leg->rates[ZL_MOST + i]));
    if (!(fastest > PAYS * staying_rate(leg, INFINITY))) return;
    leg->fastest = fastest;
    if (next > 0.0) leg->first = FIRST_STEP * pow(leg->relative, 1.0 / 8.0) / next;
}

/* How long the guard takes to fall from the end of a step, as a parabola tells it. */
static double time_left(const double *before, const double *after, double size) {
    double bend = (after[1] - before[1]) / size;
    if (after[0] < 0.0) return 0.0;
    if (bend < 0.0) return (after[1] + sqrt(after[1] * after[1] - 2.0 * bend * after[0])) / -bend;
    return after[1] < 0.0 ? -after[0] / after[1] : INFINITY;
}

/* Go over to implicit steps where they pay; 1 if so. */
static int goes_over(Leg *leg, const double *before, const double *after, double size) {
    int stuck = size <= leg->earlier_size;
    double end = leg->time + size, left;
    leg->earlier_size = size;
    /* Steps of a bounded length, which implicit ones do not exceed, stay explicit. */
    if (!(size < leg->largest_implicit && size * leg->fastest > (stuck ? STUCK : HELD))) return 0;
    left = lesser(time_left(before, after, size), leg->horizon - end);
    if (!(left * leg->fastest > LONG_LEFT && leg->fastest > PAYS * staying_rate(leg, left)))
        return 0;
    leg->size = lesser(greater(2 * size, lesser(leg->first, 1.1 * left)), leg->largest_implicit);
    leg->implicit = 1;
    leg->refused = leg->has_last = 0;
    return 1;
}

/* A first step from the sizes of state and slope; 0 if the flow is not finite. */
static double first_size(const Leg *leg) {
    double floor = leg->absolute / leg->relative, ratio = 0.0;
    int i;
    for (i = 0; i < leg->n_y; i++)
        if (!isfinite(leg->slope[i])) return 0.0;
    for (i = 0; i < leg->n_y; i++)
        ratio = greater(ratio, fabs(leg->slope[i]) / (floor + fabs(leg->y[i])));
    return ratio > 1e-5 ? 0.01 / ratio : 1e-3;
}

/* Rescale the flights to another speed after an impact. */
static void set_speed(const Machine *m, double speed) {
    const int rate = ZL_RATE + ZL_FLIGHT, guard = ZL_GUARD + ZL_FLIGHT;
    const int watched = ZL_WATCHED + ZL_FLIGHT, longest = ZL_LONGEST + ZL_FLIGHT;
    m->p[m->problem->n_p] = speed;
    tape_prepare(&m->problem->tapes[rate], m->registers[rate], m->p);
    tape_prepare(&m->problem->tapes[guard], m->registers[guard], m->p);
    tape_prepare(&m->problem->tapes[longest], m->registers[longest], m->p);
    intervals_prepare(&m->problem->tapes[watched], m->registers[watched], m->p);
    m->ready->has_jacobian[ZL_FLIGHT] = m->ready->has_lanes[ZL_FLIGHT] = 0;
}

/* Prepare a leg of a mode from a state; its times are in units of `unit`. */
static int begin_leg(const Machine *m, int mode, double unit, const double *y, double horizon,
                     double relative, double absolute) {
    zl_run *run = m->run;
    const zl_settings *settings = &run->settings;
    Leg *leg = &run->leg;
    leg->mode = mode;
    leg->n_y = m->problem->n_x + (mode == ZL_FLIGHT ? 2 : 0);
    leg->unit = unit;
    if (mode == ZL_FLIGHT && m->p[m->problem->n_p] != unit) set_speed(m, unit);
    memcpy(leg->y, y, (size_t)leg->n_y * sizeof(double));
    leg->horizon = horizon;
    leg->late = 0.0;
    leg->relative = relative;
    leg->absolute = absolute;
    /* A hop is far shorter than anything that its rates change over: explicit steps are enough. */
    leg->implicit = !settings->begins_explicit && !run->in_hop;
    leg->largest_explicit = run->in_hop ? horizon : lesser(settings->largest_explicit, horizon);
    leg->largest_implicit = lesser(settings->largest_implicit, horizon);
    leg->time = leg->largest_change = leg->earlier_size = leg->fastest = leg->first = 0.0;
    leg->refused = leg->has_last = leg->n_explicit = leg->n_steps = leg->n_polynomials = 0;
    leg->first_step = run->n_rows;
    leg->first_polynomial = run->n_polynomials;
    guard_at(m, leg->y, leg->guard);
    rate_at(m, leg->y, leg->slope);
    leg->size = first_size(leg);
    if (leg->size == 0.0) return 0;
    leg->size = lesser(leg->size, leg->implicit ? leg->largest_implicit : leg->largest_explicit);
    return 1;
}

/* Cut a step where a span of a table ends, and keep the size that it would have. */
static void cut_step(const Machine *m) {
    Leg *leg = &m->run->leg;
    const int tape = ZL_LONGEST + (int)leg->mode;
    double longest;
    leg->wanted = 0.0;
    if (!m->problem->tapes[tape].n_outputs) return;
    evaluate_at(m, tape, leg->y, &longest);
    if (!(longest < leg->size)) return;
    leg->wanted = leg->size;
    leg->size = longest;
}

/* The size of the next step. A step that was cut tells nothing against the size before it. */
static double next_size(const Leg *leg, double growth, double largest) {
    const double size = leg->size * growth;
    return lesser(leg->refused ? size : greater(size, leg->wanted), largest);
}

/* Take an accepted explicit step; a status if the step size falls to rounding level. */
static int take_explicit(const Machine *m, double *after, double *error) {
    Leg *leg = &m->run->leg;
    double slopes[12][ZL_MOST];
    memcpy(slopes[0], leg->slope, sizeof leg->slope);
    cut_step(m);
    for (;;) {
        double factor = EXPLICIT_SHRINK;
        *error = explicit_step(m, leg->y, leg->size, slopes, after);
        if (*error <= 1.0) return ZL_DONE;
        if (isfinite(*error)) factor = EXPLICIT_SAFETY * pow(*error, EXPLICIT_EXPONENT);
        /* No part of an infinite step is finite. */
        leg->size = lesser(leg->size, DBL_MAX);
        leg->size *= greater(EXPLICIT_SHRINK, factor);
        leg->refused = 1;
        if (leg->size <= 4 * spacing(leg->time) || leg->size < 1e-300) return ZL_TOO_STIFF;
    }
}

/* The same of an implicit step; `factor` is what its error lets the next one be longer by. */
static int take_implicit(const Machine *m, Found *found, double *factor) {
    Leg *leg = &m->run->leg;
    cut_step(m);
    for (;;) {
        double ratio = leg->has_last ? leg->size / leg->last_size : 0.0;
        double error = INFINITY;
        if (implicit_step(m, leg->y, leg->slope, leg->size, leg->has_last ? leg->coefficients : 0,
                          leg->has_last ? 1.0 : 0.0, ratio, found))
            error = found->error;
        *factor = UNSOLVED;
        if (error < INFINITY)
            *factor = IMPLICIT_SAFETY * pow(greater(error, 1e-300), -1.0 / (ZL_STAGES + 1));
        if (error <= 1.0) return ZL_DONE;
        leg->size = lesser(leg->size, DBL_MAX);
        leg->size *= greater(IMPLICIT_SHRINK, lesser(*factor, leg->has_last ? 1.0 : 0.5));
        leg->refused = 1;
        if (!(leg->size > 4 * spacing(leg->time)) || leg->size < 1e-300) return ZL_SINGULAR;
    }
}

static void record_step(const Machine *m, const double *after, const Found *found) {
    zl_run *run = m->run;
    zl_records *records = m->records;
    const int n = (int)run->leg.n_y;
    double *row = records->steps + records->n_steps * (ZL_STEP_WIDTH + m->problem->n_x + 2);
    row[0] = run->leg.time;
    row[1] = run->leg.size;
    memcpy(row + ZL_STEP_WIDTH, after, (size_t)n * sizeof(double));
    records->n_steps++;
    run->n_rows++;
    if (!found) return;
    memcpy(records->polynomials + records->n_polynomials * ZL_STAGES * (m->problem->n_x + 2),
           found->coefficients, (size_t)(ZL_STAGES * n) * sizeof(double));
    records->n_polynomials++;
    run->n_polynomials++;
    run->leg.n_polynomials++;
}

/* Keep the largest velocity since the last look; one that is no longer a number counts as largest. */
static void keep_fastest(const Machine *m, const double *y) {
    zl_run *run = m->run;
    const long long n_q = m->problem->n_q;
    double fastest = 0.0;
    long long i, which = 0;
    for (i = 0; i < n_q && !isnan(fastest); i++)
        if (!(fabs(y[n_q + i]) <= fastest)) {
            fastest = fabs(y[n_q + i]);
            which = i;
        }
    if (!(fastest <= run->pace.fastest)) {
        run->pace.fastest = fastest;
        run->pace.which = which;
    }
}

/* End a motion that speeds up so much that its steps will not last to the horizon. */
static int look_at_pace(const Machine *m, double time) {
    zl_run *run = m->run;
    double passed, steps, needed;
    long long i;
    zl_look *looks = run->pace.looks;
    run->pace.next_look *= 2;
    if (run->pace.n_looks == ZL_LOOKS) memmove(looks, looks + 1, (ZL_LOOKS - 1) * sizeof *looks);
    if (run->pace.n_looks < ZL_LOOKS) run->pace.n_looks++;
    looks[run->pace.n_looks - 1].steps = (double)run->pace.n_steps;
    looks[run->pace.n_looks - 1].time = time;
    looks[run->pace.n_looks - 1].speed = run->pace.fastest;
    run->pace.fastest = 0.0;
    if (run->pace.n_looks < ZL_LOOKS) return ZL_DONE;
    for (i = 1; i < ZL_LOOKS; i++)
        if (looks[i].speed < RISE * looks[i - 1].speed) return ZL_DONE;
    steps = looks[ZL_LOOKS - 1].steps - looks[ZL_LOOKS - 2].steps;
    passed = time - looks[ZL_LOOKS - 2].time;
    needed = passed > 0.0 ? (run->settings.until - time) * steps / passed : INFINITY;
    if (!((double)run->pace.n_steps + needed > (double)run->settings.most_steps)) return ZL_DONE;
    run->detail.index = m->problem->n_q + run->pace.which;
    run->detail.number = needed;
    run->detail.steps = steps;
    return ZL_GROWS;
}

/* Count a step; a status if the run takes too many or goes too far. */
static int watch(const Machine *m, const double *y) {
    zl_run *run = m->run;
    const Leg *leg = &run->leg;
    double time = leg->start_time + leg->unit * leg->time, largest = -INFINITY;
    int status = ZL_DONE;
    long long i;
    run->pace.n_steps++;
    keep_fastest(m, y);
    if (run->pace.n_steps >= run->pace.next_look) status = look_at_pace(m, time);
    if (status == ZL_DONE && run->pace.n_steps > run->settings.most_steps) status = ZL_MANY_STEPS;
    if (status == ZL_DONE) {
        for (i = 0; i < m->problem->n_q; i++) {
            double part = fabs(y[i]) / run->settings.reach[i];
            if (isnan(part)) break;
            if (part > largest) {
                largest = part;
                run->detail.index = i;
            }
        }
        if (i == m->problem->n_q && largest > 1.0) status = ZL_BEYOND;
    }
    if (status != ZL_DONE) {
        run->detail.time = time;
        run->detail.n_state = leg->n_y;
        memcpy(run->detail.state, y, (size_t)leg->n_y * sizeof(double));
    }
    return status;
}

enum { LEG_GOES_ON = 100, LEG_FELL, LEG_AT_HORIZON, LEG_FELL_BESIDE, LEG_IN_DOUBT };

/* Look at the other guards in a step up to a time, after which the leg is over or not: `beside.c`. */
static int look_beside(Step *step, double until, int is_last);

static int step_failed(zl_run *run, int status) {
    run->detail.time = run->leg.time;
    run->detail.n_state = run->leg.n_y;
    memcpy(run->detail.state, run->leg.y, sizeof run->leg.y);
    return status;
}

/* Take one step of a leg and see whether it ends there. */
static int step_leg(const Machine *m) {
    zl_run *run = m->run;
    Leg *leg = &run->leg;
    const size_t bytes = (size_t)leg->n_y * sizeof(double);
    const int was_implicit = (int)leg->implicit;
    const int may_switch = run->settings.goes_implicit && !run->in_hop && !was_implicit;
    double after[ZL_MOST], slope_after[ZL_MOST], guard[2], before[2] = {leg->guard[0], leg->guard[1]};
    double fall, end, size, error = 0.0, factor = 0.0;
    Found found;
    Step step;
    int status = was_implicit ? take_implicit(m, &found, &factor) : take_explicit(m, after, &error);
    if (status != ZL_DONE) return step_failed(run, status);
    size = leg->size;
    if (was_implicit) {
        memcpy(after, found.after, bytes);
        memcpy(leg->coefficients, found.coefficients, (size_t)ZL_STAGES * bytes);
        memcpy(guard, found.guard, sizeof guard);
        leg->last_size = size;
        leg->has_last = 1;
    } else {
        leg->n_explicit++;
        guard_at(m, after, guard);
    }
    leg->n_steps++;
    if (run->settings.records) record_step(m, after, was_implicit ? &found : 0);
    if (!run->graph.in_side) status = watch(m, after);
    if (status != ZL_DONE) return status;

    rate_at(m, after, slope_after);
    step.curve.look = look_inside;
    step.curve.size = size;
    step.curve.exact = 0;
    step.m = m;
    step.before = leg->y;
    step.slope = leg->slope;
    step.after = after;
    step.slope_after = slope_after;
    step.guard_after = guard;
    step.coefficients = was_implicit ? leg->coefficients : 0;
    step.ended[0] = NAN;
    fall = leg_fall(&step, before, guard);
    end = isnan(fall) ? size : fall;
    if (leg->time + end >= leg->horizon || !isnan(fall)) {
        const double last = leg->horizon - leg->late;
        int over = leg->time + end >= leg->horizon || leg->time + fall >= last;
        leg_end(&step, over ? leg->horizon - leg->time : fall, leg->end);
        leg->duration = over ? leg->horizon : leg->time + fall;
        if (m->others) {
            int other = look_beside(&step, lesser(leg->duration, last), 1);
            if (other != LEG_GOES_ON) return other;
        }
        return over ? LEG_AT_HORIZON : LEG_FELL;
    }
    if (m->others) {
        int other = look_beside(&step, leg->horizon - leg->late, 0);
        if (other != LEG_GOES_ON) return other;
    }
    if (leg->on_guard) {
        double change = greater(leg->largest_change, fabs(before[1]) * size);
        leg->largest_change = greater(change, fabs(guard[1]) * size);
        if (guard[0] < -greater(LEAVES * leg->largest_change, leg->rounding)) {
            run->detail.time = leg->start_time + leg->unit * leg->time;
            run->detail.n_state = m->problem->n_x;
            memcpy(run->detail.state, leg->y, bytes);
            return ZL_LEFT;
        }
        leg->on_guard = guard[0] <= leg->rounding;
    }
    if (may_switch && (leg->n_explicit == FIRST_LOOK || leg->n_explicit % PATIENCE == 0))
        look_at_rates(m, after);
    leg->guard[0] = guard[0];
    leg->guard[1] = guard[1];
    if (was_implicit) {
        leg->size = next_size(leg, lesser(leg->refused ? 1.0 : IMPLICIT_GROW, factor),
                              leg->largest_implicit);
        leg->refused = 0;
        leg->time += size;
    } else {
        int over = may_switch && goes_over(leg, before, guard, size);
        leg->time += size;
        if (!over) {
            double growth = EXPLICIT_GROW;
            if (error != 0.0) growth = EXPLICIT_SAFETY * pow(error, EXPLICIT_EXPONENT);
            leg->size = next_size(
                leg, lesser(leg->refused ? 1.0 : EXPLICIT_GROW, greater(EXPLICIT_SHRINK, growth)),
                leg->largest_explicit);
            leg->refused = 0;
        }
    }
    memcpy(leg->y, after, bytes);
    memcpy(leg->slope, slope_after, bytes);
    return LEG_GOES_ON;
}
