/* Two motions side by side, whose distance grows by the largest Lyapunov exponent: `lyapunov` in
   Python. */

enum { IS_PLACED, FIRST_MOVES, OTHER_MOVES };

/* Carry the run of a motion on to the end of its turn, and copy its last state. */
static int to_end_of_turn(const zl_problem *problem, zl_run *run, zl_records *records, double *x) {
    int status = ZL_FULL;
    while (status == ZL_FULL) status = zl_resume(problem, run, records);
    if (status == ZL_DONE) memcpy(x, run->leg.end, (size_t)problem->n_x * sizeof(double));
    return status;
}

/* The largest entry of a difference of states, by their sizes; NaN if one is NaN. */
static double largest_part(const double *difference, const double *scale, long long n) {
    double largest = 0.0;
    long long i;
    for (i = 0; i < n; i++) {
        const double part = fabs(difference[i]) / scale[i];
        if (part > largest || isnan(part)) largest = part;
        if (isnan(part)) break;
    }
    return largest;
}

/* The difference of both motions, without the clock. */
static void between_both(const zl_pair *pair, long long n, double *difference) {
    long long i;
    for (i = 0; i < n; i++)
        difference[i] = pair->in_clock[i] ? 0.0 : pair->other[i] - pair->first[i];
}

static void put_on_stop(const Machine *m, double *x) {
    double on_stop[ZL_MOST];
    to_stop(m, x, on_stop);
    memcpy(x, on_stop, (size_t)m->problem->n_x * sizeof(double));
}

/* Place the other motion at its distance from the first one, on the closed stops of the mode. Of both
   directions the first is taken that is outside of all open stops, else it is put on them. */
static void place_beside(Graph *g, zl_pair *pair) {
    const zl_graph *table = g->whole->graph;
    const long long n = g->whole->n_x;
    const double size = largest_part(pair->direction, pair->scale, n);
    const long long open = BIT(table->n_switches - table->n_declared) - 1;
    long long inside = 0, i;
    int k, sign;
    for (sign = 1; sign >= -1; sign -= 2) {
        double gap[2];
        for (i = 0; i < n; i++)
            pair->other[i] = pair->first[i] + sign * pair->distance / size * pair->direction[i];
        for (k = 0; k < table->n_stops; k++)
            if (pair->closed & BIT(k)) {
                const Machine m = view_at(g, pair->closed & ~BIT(k), pair->sides, k);
                put_on_stop(&m, pair->other);
            }
        for (inside = k = 0; k < table->n_stops; k++)
            if (!(pair->closed & BIT(k))) {
                const Machine m = view_at(g, 0, open, k);
                evaluate_at(&m, ZL_GAP, pair->other, gap);
                if (gap[0] < 0.0) inside |= BIT(k);
            }
        if (!inside) return;
    }
    for (k = 0; k < table->n_stops; k++)
        if (inside & BIT(k)) {
            const Machine m = view_at(g, 0, open, k);
            put_on_stop(&m, pair->other);
        }
}

/* Take the rate of a turn, and the direction of the next one from the distance at its end. */
static double rate_of_turn(zl_pair *pair, long long n) {
    double away[ZL_MOST], end, growth;
    between_both(pair, n, away);
    end = largest_part(away, pair->scale, n);
    if (end > pair->vanished * pair->distance) 
        memcpy(pair->direction, away, (size_t)n * sizeof(double));
    growth = end / pair->started;
    return log(pair->vanished > growth ? pair->vanished : growth) / pair->turn;
}

/* Place the other motion for the next turn; 0 if that asks for a missing mode. */
static int begin_turn(const zl_problem *problem, zl_run *run, zl_records *records, zl_pair *pair) {
    double away[ZL_MOST];
    Graph g;
    enter_graph(&g, problem, run, records);
    place_beside(&g, pair);
    if (g.asks) {
        memcpy(run->detail.about, g.asked, sizeof g.asked);
        return 0;
    }
    between_both(pair, problem->n_x, away);
    pair->started = largest_part(away, pair->scale, problem->n_x);
    begin_at(problem, run, pair->first);
    pair->moves = FIRST_MOVES;
    return 1;
}

/* Follow both motions up to a number of turns, with a rate for each that began apart. */
int zl_turns(const zl_problem *problem, zl_run *run, zl_records *records, zl_pair *pair,
             long long count) {
    int status;
    while (pair->n_turns < count) {
        if (pair->moves == IS_PLACED && !begin_turn(problem, run, records, pair)) return ZL_MODE;
        if (pair->moves == FIRST_MOVES) {
            status = to_end_of_turn(problem, run, records, pair->first);
            if (status != ZL_DONE) return status;
            pair->closed = run->graph.rest;
            if (run->leg.mode == ZL_LOCKED) pair->closed |= BIT(run->graph.focus);
            pair->sides = run->graph.sides;
            begin_at(problem, run, pair->other);
            pair->moves = OTHER_MOVES;
        }
        status = to_end_of_turn(problem, run, records, pair->other);
        if (status != ZL_DONE) return status;
        if (pair->started > 0.0)
            pair->rates[pair->n_rates++] = rate_of_turn(pair, problem->n_x);
        pair->moves = IS_PLACED;
        pair->n_turns++;
    }
    return ZL_DONE;
}
