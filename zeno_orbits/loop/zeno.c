/* The end of an impact sequence: `zeno_limit`, `completion` and `zeno_passage` in Python. */

typedef struct {
    double time, error, state[ZL_MOST];
} Limit;

/* An estimate: impact time, speed, gap acceleration, time of the limit; state on the stop; limit. */
enum { E_IMPACT, E_SPEED, E_LIFT, E_TIME };

static double speed_of(const Machine *m, long long k) { return estimate_of(m, k)[E_SPEED]; }

/* Which of the falling speeds to extrapolate from, the last first; their number. */
static int spread_nodes(const Machine *m, long long last, long long *nodes) {
    const long long first = m->run->graph.first_node;
    int count = 1;
    nodes[0] = last;
    while (count < N_NODES) {
        double wanted = speed_of(m, nodes[count - 1]) / NODE_RATIO;
        long long before = nodes[count - 1] - 1, low = first, high = last + 1;
        if (before >= first && 0.0 < wanted && wanted <= speed_of(m, before)) {
            nodes[count++] = before;
            continue;
        }
        while (low < high) {
            long long middle = (low + high) / 2;
            if (-wanted < -speed_of(m, middle))
                high = middle;
            else
                low = middle + 1;
        }
        if (low - 1 < first || wanted == 0.0) break;
        nodes[count++] = low - 1;
    }
    return count;
}

/* The weights, at zero, of the polynomial without linear term in falling speeds. */
static void limit_weights(const double *speeds, int n, double *weights) {
    double shares[N_NODES] = {0.0}, total;
    int j, k;
    for (k = 0; k < n; k++) shares[k] = speeds[n - 1] / speeds[k];
    total = shares[0];
    for (k = 1; k < n; k++) total += shares[k];
    for (k = 0; k < n; k++) {
        double product = 1.0;
        for (j = 0; j < n; j++)
            if (j != k) product *= speeds[j] / (speeds[j] - speeds[k]);
        weights[k] = shares[k] / total * product;
    }
    if (n == 1) weights[0] = 1.0;
}

/* The limit that a polynomial without linear term through some nodes has. */
static void limit_of(const Machine *m, const long long *nodes, int n, Limit *limit) {
    const long long n_x = m->problem->n_x;
    double speeds[N_NODES] = {0.0}, weights[N_NODES];
    int i, k;
    for (k = 0; k < n; k++) speeds[k] = speed_of(m, nodes[n - 1 - k]);
    limit_weights(speeds, n, weights);
    limit->time = 0.0;
    for (k = 0; k < n; k++) {
        const double *estimate = estimate_of(m, nodes[n - 1 - k]);
        const double *state = estimate + ZL_ESTIMATE_WIDTH + n_x;
        limit->time += weights[k] * estimate[E_TIME];
        for (i = 0; i < n_x; i++)
            limit->state[i] = k == 0 ? weights[0] * state[i] : limit->state[i] + weights[k] * state[i];
    }
}

/* The extrapolated limit, not yet moved onto the stop, and the estimate of its error. */
static void combine(const Machine *m, Limit *limit) {
    const zl_settings *settings = &m->run->settings;
    const long long last = m->run->pace.n_estimates - 1;
    long long nodes[N_NODES], earlier[N_NODES];
    int n = spread_nodes(m, last, nodes), i;
    Limit before;
    limit_of(m, nodes, n, limit);
    if (n == 1) {
        limit->error = speed_of(m, last) == 0.0 ? 0.0 : INFINITY;
        return;
    }
    limit_of(m, earlier, spread_nodes(m, nodes[1], earlier), &before);
    limit->error = fabs(limit->time - before.time) / (settings->time + fabs(limit->time));
    for (i = 0; i < m->problem->n_x; i++)
        limit->error = greater(limit->error, fabs(limit->state[i] - before.state[i]) /
                                                 (settings->sizes[i] + fabs(limit->state[i])));
}

/* The speed after an impact, and the sum of all later speeds beyond the geometric one. */
static double rebound(const Machine *m, double speed) {
    double approach = -speed, after;
    evaluate_at(m, ZL_REBOUND, &approach, &after);
    return after;
}

static double speeds_excess(const Machine *m, double speed) {
    const double e = m->settings->restitution;
    double w = speed, excess = 0.0;
    int count;
    if (!m->settings->varies) return 0.0;
    for (count = 0; w > FALLEN * speed; count++) {
        const double after = rebound(m, w);
        if (count == MOST_FALLS) return INFINITY;
        excess += (after - e * w) / (1 - e);
        w = after;
    }
    return excess;
}

/* The error of a limit that the change of the restitution with the speed causes. */
static double law_error(const Machine *m, const Limit *limit) {
    const zl_settings *settings = &m->run->settings;
    const long long last_one = m->run->pace.n_estimates - 1;
    const double *last = estimate_of(m, last_one);
    const double *rested = last + ZL_ESTIMATE_WIDTH, tail = last[E_TIME] - last[E_IMPACT];
    long long nodes[N_NODES];
    double speeds[N_NODES] = {0.0}, weights[N_NODES], excess = 0.0, late, error;
    int n, k, i;
    if (!settings->varies || !(tail > 0.0)) return 0.0;
    n = spread_nodes(m, last_one, nodes);
    for (k = 0; k < n; k++) speeds[k] = speed_of(m, nodes[n - 1 - k]);
    limit_weights(speeds, n, weights);
    for (k = 0; k < n; k++) excess += weights[k] * speeds_excess(m, speeds[k]);
    late = fabs(2 * excess / -last[E_LIFT]);
    if (isnan(late)) return INFINITY;
    error = late / (settings->time + fabs(limit->time));
    for (i = 0; i < m->problem->n_x; i++)
        error = greater(error, fabs((rested[m->problem->n_x + i] - rested[i]) * (late / tail)) /
                                   (settings->sizes[i] + fabs(limit->state[i])));
    return error;
}

/* Move a state onto the stop. */
static void to_stop(const Machine *m, const double *x, double *state) {
    double outputs[2 * ZL_MOST + 1];
    evaluate_at(m, ZL_RESTING, x, outputs);
    memcpy(state, outputs, (size_t)m->problem->n_x * sizeof(double));
}

/* The limit as far as extrapolation tells it; 0 if more impacts have to be resolved. */
static int extrapolated(const Machine *m, double resolved, double tolerance, Limit *limit) {
    const double *last = estimate_of(m, m->run->pace.n_estimates - 1);
    if (last[E_SPEED] > resolved * m->run->first_speed) return 0;
    combine(m, limit);
    if (limit->error > tolerance) return 0;
    limit->error += law_error(m, limit);
    if (limit->error > tolerance) return 0;
    to_stop(m, limit->state, limit->state);
    return fabs(number_at(m, ZL_LIFT, limit->state) - last[E_LIFT]) <= MAY_BEND * fabs(last[E_LIFT]);
}

/* Flights that a sequence still needs impact by impact, about. */
static double flights_left(const Machine *m) {
    const zl_settings *settings = &m->run->settings;
    double speed = speed_of(m, m->run->pace.n_estimates - 1), left;
    if (settings->restitution == 0.0 || speed == 0.0) return 0.0;
    left = log(settings->resolved * m->run->first_speed / speed) / log(settings->restitution);
    left = nearbyint(left);
    return left > 0.0 ? left : 0.0;
}

static double largest_of(const double *change, const double *z, long long n) {
    double largest = 0.0;
    long long i;
    for (i = 0; i < n; i++) {
        double part = fabs(change[i]) / (1 + fabs(z[i]));
        if (isnan(part)) return part;
        largest = greater(largest, part);
    }
    return largest;
}

/* Whether the curve of the first `n` impacts is worth a try, as far as the last six tell. */
static int is_settled(const Machine *m, long long n) {
    const long long n_x = m->problem->n_x;
    const double e = m->run->settings.restitution;
    double states[DIFFERENCES + 2][ZL_MOST], last[ZL_MOST], before, now, ratio, amplitude;
    int i, k, order;
    if (n < DIFFERENCES + 2) return 0;
    for (k = 0; k < DIFFERENCES + 2; k++) {
        const double *estimate = estimate_of(m, n - DIFFERENCES - 2 + k) + ZL_ESTIMATE_WIDTH;
        for (i = 0; i < n_x; i++) states[k][i] = estimate[i] / m->run->settings.sizes[i];
    }
    memcpy(last, states[DIFFERENCES + 1], sizeof last);
    for (order = 1; order <= DIFFERENCES; order++)
        for (k = 0; k < DIFFERENCES + 2 - order; k++)
            for (i = 0; i < n_x; i++) states[k][i] = states[k + 1][i] - states[k][i];
    before = largest_of(states[0], last, n_x);
    now = largest_of(states[1], last, n_x);
    if (now <= SEEN + SMOOTH * pow(1 - e, DIFFERENCES) || now >= before) return 1;
    ratio = now / before;
    amplitude = now / pow(1 - ratio, DIFFERENCES);
    return log(amplitude / DECAYED) > -WORTH_WAITING * log(ratio);
}

/* Whether the curve is worth a try after the last impact. */
static int curve_is_due(const Machine *m) {
    const long long n = m->run->pace.n_estimates;
    const double *last = estimate_of(m, n - 1);
    double state[ZL_MOST];
    long long tries = FIRST_TRY;
    int again, k;
    for (k = 0; k < 15 && tries < n; k++) tries *= 4;
    again = tries == n;
    if (!is_settled(m, n) || (!again && is_settled(m, n - 1))) return 0;
    to_stop(m, last + ZL_ESTIMATE_WIDTH + m->problem->n_x, state);
    return number_at(m, ZL_LIFT, state) / last[E_LIFT] > STILL_HOLDS;
}

enum { NO_LIMIT, LIMIT, CURVE };

/* The Zeno point, if the impacts so far tell it by the rule of completion. */
static int limit_by_rule(const Machine *m, Limit *limit) {
    zl_run *run = m->run;
    const zl_settings *settings = &run->settings;
    const double *last = estimate_of(m, run->pace.n_estimates - 1);
    switch (settings->completion) {
    case ZL_TRUNCATION:
        if (last[E_SPEED] >= rebound(m, settings->delta)) return NO_LIMIT;
        limit->time = last[E_IMPACT];
        limit->error = last[E_TIME] - last[E_IMPACT];
        memcpy(limit->state, last + ZL_ESTIMATE_WIDTH,
               (size_t)m->problem->n_x * sizeof(double));
        return LIMIT;
    case ZL_PLASTIC_AFTER:
        if ((double)run->pace.n_estimates < settings->n_fixed) return NO_LIMIT;
        limit->time = last[E_IMPACT];
        limit->error = 0.0;
        memcpy(limit->state, last + ZL_ESTIMATE_WIDTH,
               (size_t)m->problem->n_x * sizeof(double));
        return LIMIT;
    case ZL_FIXED_IMPACTS:
        if ((double)run->pace.n_estimates < settings->n_fixed) return NO_LIMIT;
        combine(m, limit);
        limit->error += law_error(m, limit);
        to_stop(m, limit->state, limit->state);
        return LIMIT;
    }
    if (extrapolated(m, settings->resolved, settings->limit_tolerance, limit)) return LIMIT;
    if (settings->completion != ZL_PASSAGE) return NO_LIMIT;
    if (flights_left(m) < WORTHWHILE || !curve_is_due(m)) return NO_LIMIT;
    run->detail.time = last[E_IMPACT];
    run->detail.number = last[E_SPEED];
    run->detail.steps = flights_left(m);
    run->detail.n_state = m->problem->n_x;
    memcpy(run->detail.state, last + ZL_ESTIMATE_WIDTH, (size_t)m->problem->n_x * sizeof(double));
    return CURVE;
}

/* Put the line through two impacts beside dry friction, at speed zero, in place of an estimate: `join` in
   Python. */
static void join_estimates(const double *before, double *last, long long n_x) {
    const double share = last[E_SPEED] / (before[E_SPEED] - last[E_SPEED]);
    long long i;
    last[E_TIME] = last[E_IMPACT] + share * (last[E_IMPACT] - before[E_IMPACT]);
    before += ZL_ESTIMATE_WIDTH;
    last += ZL_ESTIMATE_WIDTH;
    for (i = 0; i < n_x; i++) last[n_x + i] = last[i] + share * (last[i] - before[i]);
}

/* Add the first-order guess of the Zeno point from an impact; 0 if the stop repels there or is elastic.
   The flight before it may have had switches of dry friction. */
static int add_estimate(const Machine *m, long long beside) {
    zl_run *run = m->run;
    const zl_start *start = &run->start;
    const long long n_x = m->problem->n_x;
    double *estimate = estimate_of(m, run->pace.n_estimates), remaining;
    long long i;
    if (!(start->lift < 0.0) || run->settings.restitution == 1.0) return 0;
    remaining = 2 * start->speed / (-start->lift * (1 - run->settings.restitution));
    estimate[E_IMPACT] = start->time;
    estimate[E_SPEED] = start->speed;
    estimate[E_LIFT] = start->lift;
    estimate[E_TIME] = start->time + remaining;
    for (i = 0; i < n_x; i++) {
        estimate[ZL_ESTIMATE_WIDTH + i] = start->resting[i];
        estimate[ZL_ESTIMATE_WIDTH + n_x + i] = start->resting[i] + remaining * start->rate[i];
    }
    if (run->pace.n_estimates == 0) {
        run->graph.first_node = run->graph.beside = 0;
        run->first_speed = start->speed;
    } else {
        if (run->graph.beside != beside) {
            run->graph.first_node = run->pace.n_estimates;
            run->first_speed = start->speed;
        }
        if (beside) join_estimates(estimate_of(m, run->pace.n_estimates - 1), estimate, n_x);
        run->graph.beside = beside;
    }
    run->pace.n_estimates++;
    return 1;
}
