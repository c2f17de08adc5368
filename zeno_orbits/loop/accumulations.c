/* Events that accumulate without a Zeno point of one stop: `accumulations` in Python. */

/* Keep what an error is about. */
static int tell(const Machine *m, int status, double time, const double *x, long long index) {
    zl_run *run = m->run;
    run->detail.time = time;
    run->detail.n_state = m->problem->n_x;
    memcpy(run->detail.state, x, (size_t)m->problem->n_x * sizeof(double));
    run->detail.index = index;
    return status;
}

static int tell_two(const Machine *m, int status, double time, const double *x, long long first,
                    long long second) {
    m->run->detail.about[0] = first;
    m->run->detail.about[1] = second;
    return tell(m, status, time, x, second);
}

/* Whether the last impacts are on several stops in turn. */
static int come_in_turn(const Graphed *graph) {
    long long k;
    int changes = 0;
    for (k = 1; k < graph->n_turn; k++)
        changes += graph->turn_stops[k] != graph->turn_stops[k - 1];
    return graph->n_turn >= LAST_IMPACTS && changes >= CHANGES;
}

/* The error of impacts that accumulate on several stops in turn. */
static int in_turn(const Machine *m, double time, const double *x) {
    const Graphed *graph = &m->run->graph;
    long long k, last = graph->turn_stops[graph->n_turn - 1], others = 0;
    for (k = 0; k < graph->n_turn; k++) others |= 1LL << graph->turn_stops[k];
    return tell_two(m, ZL_IN_TURN, time, x, last, others & ~(1LL << last));
}

/* Record an impact; 1 if impacts on several stops in turn become ever more frequent. */
static int see_impact(const Machine *m, double time) {
    Graphed *graph = &m->run->graph;
    double middle;
    if (graph->n_turn == IN_TURN) {
        memmove(graph->turn_times, graph->turn_times + 1, (IN_TURN - 1) * sizeof(double));
        memmove(graph->turn_stops, graph->turn_stops + 1, (IN_TURN - 1) * sizeof(long long));
        graph->n_turn--;
    }
    graph->turn_times[graph->n_turn] = time;
    graph->turn_stops[graph->n_turn++] = graph->focus;
    if (!come_in_turn(graph)) return 0;
    middle = graph->turn_times[graph->n_turn / 2];
    return time - middle < middle - graph->turn_times[0];
}

/* Whether the last impacts on several stops nearly coincide. */
static int is_in_corner(const Machine *m) {
    const Graphed *graph = &m->run->graph;
    const long long n = graph->n_turn;
    if (!come_in_turn(graph)) return 0;
    return graph->turn_times[n - 1] - graph->turn_times[n - 2] < CORNER * m->run->settings.time;
}

/* Record an event of a declared switch, unless such events accumulate. */
static int see_switch(const Machine *m, double time, long long k, const double *x) {
    Graphed *graph = &m->run->graph;
    double *times = graph->row_times[k], intervals[IN_ROW - 1];
    const double scale = m->run->settings.time;
    int n, i, shrinks, fast;
    if (graph->n_row[k] == IN_ROW) {
        memmove(times, times + 1, (IN_ROW - 1) * sizeof(double));
        graph->n_row[k]--;
    }
    times[graph->n_row[k]++] = time;
    n = (int)graph->n_row[k] - 1;
    for (i = 0; i < n; i++) intervals[i] = times[i + 1] - times[i];
    shrinks = n == IN_ROW - 1;
    for (i = 1; i < n; i++) shrinks = shrinks && intervals[i] - intervals[i - 1] < 0.0;
    fast = n >= 3;
    for (i = 0; fast && i < 2; i++) fast = intervals[n - 2 + i] < FAST * intervals[n - 3 + i];
    if ((shrinks && intervals[n - 1] < SHORT * scale) || (fast && intervals[n - 1] < SOON * scale))
        return tell(m, ZL_ACCUMULATE, time, x, k);
    return GO_ON;
}

/* Refuse a Zeno point at which events of a switch accumulate as well. */
static int may_reach(const Machine *m, const Limit *limit) {
    const Graphed *graph = &m->run->graph;
    long long k;
    for (k = 0; k < m->graph->n_declared; k++) {
        const long long n = graph->n_row[k];
        const double *times = graph->row_times[k] + n - COMPARED;
        double intervals[COMPARED], most = -INFINITY, least = INFINITY;
        int i, is_known = 1;
        if (n < COMPARED) continue;
        for (i = 0; i < COMPARED; i++)
            intervals[i] = (i + 1 < COMPARED ? times[i + 1] : limit->time) - times[i];
        if (!(intervals[COMPARED - 1] < SOON * m->run->settings.time)) continue;
        for (i = 1; i < COMPARED; i++) {
            const double ratio = intervals[i] / intervals[i - 1];
            is_known = is_known && !isnan(ratio);
            most = greater(most, ratio);
            least = lesser(least, ratio);
        }
        if (is_known && most < FALLING && least > ALIKE * most)
            return tell_two(m, ZL_TOGETHER, limit->time, limit->state, graph->focus, k);
    }
    return GO_ON;
}
