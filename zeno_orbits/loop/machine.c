/* Events of the stop that a run looks at, and the legs between them: `stop_run` in Python. */

enum { GO_ON = 200 };

static void start_without_speed(zl_run *run, long long mode, double time) {
    run->start.mode = mode;
    run->start.time = time;
    run->start.has_speed = run->start.has_impact = 0;
    run->start.speed = NAN;
    run->start.height = 0.0;
    run->start.launch = 1.0;
    run->stage = AT_START;
}

static void write_event_of(const Machine *m, int kind, long long index, double time,
                           const double *numbers, const double *before, const double *after) {
    const size_t n_x = (size_t)m->problem->n_x;
    zl_records *records = m->records;
    double *row = records->events + records->n_events * (ZL_EVENT_WIDTH + 2 * m->problem->n_x);
    row[0] = kind;
    row[1] = time;
    memcpy(row + 2, numbers, 3 * sizeof(double));
    row[5] = (double)index;
    m->run->graph.has_events = 1;
    if (kind == ZL_IMPACT || kind == ZL_RELEASE) {
        double gap[2];
        evaluate_at(m, ZL_GAP, after, gap);
        m->run->graph.met_times[index] = time;
        m->run->graph.met_gaps[index] = gap[0];
    }
    if (kind == ZL_SWITCH && index < m->graph->n_declared) m->run->graph.last_switch = index;
    memcpy(row + ZL_EVENT_WIDTH, before, n_x * sizeof(double));
    memcpy(row + ZL_EVENT_WIDTH + n_x, after, n_x * sizeof(double));
    records->n_events++;
}

/* Record an event of the stop that the run looks at. */
static void write_event(const Machine *m, int kind, double time, const double *numbers,
                        const double *before, const double *after) {
    write_event_of(m, kind, m->run->graph.focus, time, numbers, before, after);
}

static void write_arc(const Machine *m, const double *numbers, const double *start,
                      const double *end, long long n_y) {
    const size_t n_x = (size_t)m->problem->n_x;
    zl_records *records = m->records;
    double *row;
    m->run->n_arcs++;
    if (!m->run->settings.records) return;
    row = records->arcs + records->n_arcs * (ZL_ARC_WIDTH + 2 * m->problem->n_x + 2);
    memcpy(row, numbers, ZL_ARC_WIDTH * sizeof(double));
    memcpy(row + ZL_ARC_WIDTH, start, n_x * sizeof(double));
    memcpy(row + ZL_ARC_WIDTH + n_x, end, (size_t)n_y * sizeof(double));
    records->n_arcs++;
}

/* Record the leg that has just ended as an arc. */
static void write_leg(const Machine *m, int ending, double end_time) {
    const zl_run *run = m->run;
    const Leg *leg = &run->leg;
    const double numbers[ZL_ARC_WIDTH] = {(double)leg->mode,
                                          leg->start_time,
                                          end_time,
                                          leg->unit,
                                          leg->duration,
                                          (double)ending,
                                          (double)run->n_impacts,
                                          (double)leg->first_step,
                                          (double)leg->n_steps,
                                          (double)leg->first_polynomial,
                                          (double)leg->n_polynomials,
                                          leg->launch,
                                          leg->height,
                                          (double)run->graph.view};
    write_arc(m, numbers, run->start.state, leg->end, leg->n_y);
}

/* Whether the gap opens by less than its rounding before it closes again: that is no flight. After a
   plastic impact it is followed in its own time, however low it is. */
static int closes_at_once(const Machine *m, const double *x, double lift) {
    const double rate = number_at(m, ZL_PULL, x), inertia = number_at(m, ZL_INERTIA, x);
    const double fall = rate / inertia;
    double largest = 0.0;
    long long i;
    if (m->settings->restitution == 0.0 &&
        3.0 * lift * inertia > HOP_BRIEF * m->settings->time * rate)
        return 0;
    for (i = 0; i < m->problem->n_q; i++) {
        largest = greater(largest, fabs(x[i]));
        if (isnan(x[i])) return 0;
    }
    return lift > 0.0 && fall > 0.0 &&
           2.0 * pow(lift, 3) <= 3.0 * (ROUNDING * largest) * pow(fall, 2);
}

/* Whether the stop neither holds nor repels a state on it, to rounding. */
static int is_slack(const Machine *m, const double *x, double lift) {
    const zl_settings *settings = m->settings;
    if (fabs(lift) <= settings->contact * settings->gap_acceleration) return 1;
    if (!(lift > 0.0)) return 0;
    return closes_at_once(m, x, lift);
}

/* The mode that holds on the stop at zero gap rate. */
static int mode_on_stop(const Machine *m, const double *x) {
    double lift = number_at(m, ZL_LIFT, x);
    int holds = is_slack(m, x, lift) ? number_at(m, ZL_PULL, x) > 0.0 : lift < 0.0;
    return holds ? ZL_LOCKED : ZL_FREE;
}

/* Record a Zeno point and the tail that leads to it, an arc without steps. */
static void reach(const Machine *m, const Limit *limit, double last_time, double last_speed) {
    zl_run *run = m->run;
    Graphed *graph = &run->graph;
    long long k, n = 0;
    const double tail = limit->time - last_time;
    const double told[3] = {limit->error, tail, last_speed};
    double state[ZL_MOST];
    /* Its impacts have come to their limit: they no longer come in turn with others. */
    for (k = 0; k < graph->n_turn; k++)
        if (graph->turn_stops[k] != graph->focus) {
            graph->turn_times[n] = graph->turn_times[k];
            graph->turn_stops[n++] = graph->turn_stops[k];
        }
    graph->n_turn = n;
    write_event(m, ZL_ZENO, limit->time, told, limit->state, limit->state);
    if (limit->time > last_time) {
        const double numbers[ZL_ARC_WIDTH] = {ZL_FREE,
                                              last_time,
                                              limit->time,
                                              1.0,
                                              tail,
                                              ZL_ZENO,
                                              (double)run->n_impacts,
                                              (double)run->n_rows,
                                              0.0,
                                              (double)run->n_polynomials,
                                              0.0,
                                              0.0,
                                              0.0,
                                              (double)run->graph.view};
        to_stop(m, run->start.plus, state);
        write_arc(m, numbers, state, limit->state, m->problem->n_x);
    }
}

/* Whether a sequence of impacts may end at a Zeno point: `accumulations.c`. */
static int may_reach(const Machine *m, const Limit *limit);

/* Apply the reset map and see what follows it. */
static int impact(const Machine *m, double time, const double *before, double approach) {
    zl_run *run = m->run;
    zl_start *start = &run->start;
    const zl_settings *settings = &run->settings;
    const size_t n_x = (size_t)m->problem->n_x, bytes = n_x * sizeof(double);
    const double told[3] = {approach, 0.0, 0.0};
    double given[ZL_MOST + 1], landed[3 * ZL_MOST + 2], speed;
    run->detail.time = time;
    run->detail.number = approach;
    run->detail.n_state = (long long)n_x;
    memcpy(run->detail.state, before, bytes);
    if (!(approach < 0.0)) return ZL_NOT_CLOSING;
    memcpy(given, before, bytes);
    given[n_x] = approach;
    evaluate_at(m, ZL_LANDING, given, landed);
    evaluate_at(m, ZL_REBOUND, &approach, &speed);
    if (settings->varies && !(0.0 <= speed && speed <= -approach)) {
        run->detail.steps = speed;
        run->detail.index = run->graph.focus;
        return ZL_BEYOND_LAW;
    }
    if (landed[n_x] < -INSIDE * (settings->gap_rate - approach)) return ZL_INTO_STOP;
    write_event(m, ZL_IMPACT, time, told, before, landed);
    run->n_impacts++;
    if (run->n_arcs > 0) {
        run->n_landings++;
        if ((double)run->n_landings >= settings->most_landings) {
            run->stage = OVER;
            return GO_ON;
        }
    }
    memcpy(start->plus, landed, bytes);
    memcpy(start->resting, landed + n_x + 1, bytes);
    start->lift = landed[2 * n_x + 1];
    memcpy(start->rate, landed + 2 * n_x + 2, bytes);
    if (speed <= run->small_rate) {
        int mode = mode_on_stop(m, start->resting);
        if (mode == ZL_FREE || speed == 0.0) {
            if (mode == ZL_LOCKED) {
                Limit limit;
                int status;
                limit.time = time;
                limit.error = 0.0;
                memcpy(limit.state, start->resting, bytes);
                status = may_reach(m, &limit);
                if (status != GO_ON) return status;
                reach(m, &limit, time, 0.0);
            }
            start_without_speed(run, mode, time);
            memcpy(start->state, start->resting, bytes);
            return GO_ON;
        }
    }
    run->stage = AT_START;
    start->mode = ZL_FREE;
    start->time = time;
    start->speed = speed;
    start->height = 0.0;
    start->launch = 1.0;
    start->has_speed = start->has_impact = 1;
    memcpy(start->state, start->plus, bytes);
    return GO_ON;
}

/* Apply the impact at the end of a flight, or fly on from a graze. */
static int landing(const Machine *m, double time, const double *state, double rate) {
    zl_start *start = &m->run->start;
    if (!(rate > 0.0)) return impact(m, time, state, rate);
    m->run->stage = AT_START;
    start->mode = ZL_FREE;
    start->time = time;
    start->speed = rate;
    start->height = 0.0;
    start->launch = 1.0;
    start->has_speed = 1;
    start->has_impact = 0;
    memcpy(start->state, state, (size_t)m->problem->n_x * sizeof(double));
    return GO_ON;
}

static void start_on_stop(const Machine *m, double time, const double *x) {
    double state[ZL_MOST];
    to_stop(m, x, state);
    start_without_speed(m->run, mode_on_stop(m, state), time);
    memcpy(m->run->start.state, state, (size_t)m->problem->n_x * sizeof(double));
}

/* Record a release, and start the flight after it. */
static int release(const Machine *m, double time, const double *x) {
    zl_run *run = m->run;
    const double none[3] = {0.0, 0.0, 0.0};
    double state[ZL_MOST];
    to_stop(m, x, state);
    write_event(m, ZL_RELEASE, time, none, state, state);
    run->n_releases++;
    start_without_speed(run, ZL_FREE, time);
    memcpy(run->start.state, state, (size_t)m->problem->n_x * sizeof(double));
    if ((double)run->n_releases >= run->settings.most_releases) run->stage = OVER;
    return GO_ON;
}

/* Whether there are guards beside that of the stop. */
static int has_others(const Machine *m) { return m->graph->n_stops + m->graph->n_switches > 1; }

/* The time before the end of a run in which no event counts: a leg from there would be shorter than
   the rounding of times, or than the time by which two events are apart. */
static double late_in(const Machine *m) {
    const double late = LATE * spacing(m->run->settings.until);
    return has_others(m) ? greater(late, APART * m->run->settings.time) : late;
}

/* Start a leg of a mode from where the next arc starts, up to a time. A flight from the stop is launched
   at a scaled gap rate of 1, or of 0 where its unit of time is no speed. */
static int start_leg_at(const Machine *m, int mode, double unit, double launch, double rounding,
                        double absolute, int on_guard, double until) {
    zl_run *run = m->run;
    const zl_start *start = &run->start;
    const zl_settings *settings = &run->settings;
    double y[ZL_MOST];
    memcpy(y, start->state, (size_t)m->problem->n_x * sizeof(double));
    if (mode == ZL_FLIGHT) {
        y[m->problem->n_x] = start->height;
        y[m->problem->n_x + 1] = launch;
    }
    run->leg.launch = launch;
    run->leg.height = start->height;
    run->leg.start_time = start->time;
    run->leg.on_guard = on_guard;
    run->leg.rounding = rounding;
    if (!begin_leg(m, mode, unit, y, (until - start->time) / unit, settings->relative, absolute)) {
        run->leg.time = 0.0;
        return step_failed(run, ZL_NOT_FINITE);
    }
    if (until == settings->until) run->leg.late = late_in(m) / unit;
    run->stage = IN_LEG;
    return GO_ON;
}

/* The absolute error of a flight, after an impact not below what rounding permits. */
static double flight_error(const zl_run *run) {
    const zl_settings *settings = &run->settings;
    const double size = settings->gap_acceleration, lift = fabs(run->start.lift);
    const int is_known = run->start.has_impact || run->start.height > 0.0;
    double rounding;
    if (!is_known || !(2.0 * run->start.speed <= BRIEF * settings->time * lift))
        return settings->absolute;
    rounding = ROUNDING * size / greater(lift, settings->contact * size);
    return rounding > settings->relative ? rounding : settings->absolute;
}

/* Start on the stop in the other mode: the flow itself decides which one holds. With gap, rate and
   multiplier zero, and its rate, one of the two is left at once. */
static int start_other_mode(const Machine *m, int mode) {
    zl_run *run = m->run;
    const double *x = run->start.state;
    const double rate = fabs(number_at(m, ZL_PULL, x));
    run->detail = run->first_detail;
    if (run->refused == run->start.time ||
        !(rate <= STEADY * run->settings.multiplier / run->settings.time) ||
        !is_slack(m, x, number_at(m, ZL_LIFT, x)))
        return ZL_LEFT;
    run->refused = run->start.time;
    start_without_speed(run, mode, run->start.time);
    return GO_ON;
}

/* The rounding of the gap rate by the rounding of its states. */
static double rounding_of_rate(const Machine *m, const double *x, double rate) {
    double moved[ZL_MOST], pair[2], sum = 0.0;
    long long k;
    memcpy(moved, x, (size_t)m->problem->n_x * sizeof(double));
    for (k = 0; k < m->problem->n_x; k++) {
        moved[k] += ROUNDING * x[k];
        evaluate_at(m, ZL_GAP, moved, pair);
        sum += fabs(pair[1] - rate);
        moved[k] = x[k];
    }
    return sum;
}

/* The flight from the stop that is lower than the rounding of the gap, because the multiplier turns
   round or rises. */
static Hop small_hop(const Machine *m) {
    const zl_settings *settings = &m->run->settings;
    const double *x = m->run->start.state;
    double time = HOP_PART * settings->time;
    double rate[ZL_MOST], ahead[ZL_MOST], behind[ZL_MOST], gap[2], fall, turn, lift, push, inertia;
    double highest;
    Hop hop = {0.0, 0.0, 0.0, 0.0, 0};
    int rises;
    long long i;
    evaluate_at(m, ZL_GAP, x, gap);
    if (!(gap[0] <= m->run->small_gap && fabs(gap[1]) <= m->run->small_rate)) return hop;
    lift = number_at(m, ZL_LIFT, x);
    if (!(lift >= -settings->contact * settings->gap_acceleration)) return hop;
    inertia = number_at(m, ZL_INERTIA, x);
    push = greater(lift, 0.0) * inertia;
    fall = -number_at(m, ZL_PULL, x);
    rises = fall < 0.0 && 0.0 < push;
    if (rises) time = lesser(time, PART_OF_HOP * (3.0 * push / -fall));
    evaluate_at(m, ZL_RATE + ZL_LOCKED, x, rate);
    for (i = 0; i < m->problem->n_x; i++) {
        double shift = time * rate[i];
        ahead[i] = x[i] + shift;
        behind[i] = x[i] - shift;
    }
    turn = (number_at(m, ZL_PULL, ahead) - number_at(m, ZL_PULL, behind)) / (2 * time);
    if (rises && fall * fall > HOP_TURNS * push * -turn)
        /* Without the difference of nearly equal numbers that the other form has. */
        hop.duration = 6.0 * push / (sqrt(fall * fall + 3.0 * push * greater(turn, 0.0)) - fall);
    else if (turn > 0.0)
        hop.duration = 2.0 * (fall + sqrt(fall * fall + 3.0 * push * turn)) / turn;
    highest = (push + fabs(fall) * hop.duration) / inertia;
    if (!(hop.duration > 0.0 &&
          highest * (hop.duration * hop.duration) <=
              (rises ? LOW_RISING : HOP_LOW) * settings->gap)) {
        hop.duration = 0.0;
        return hop;
    }
    hop.error = greater(settings->relative * highest, ROUNDING * settings->gap_acceleration);
    hop.launch = hop.error * sqrt(hop.error / highest);
    if (gap[1] > rounding_of_rate(m, x, gap[1])) {
        /* Another event meets the flight under way. */
        hop.launch = greater(hop.launch, gap[1] / hop.duration);
        hop.height = greater(gap[0], 0.0) / (hop.duration * hop.duration);
    }
    return hop;
}

static int has_room(const Machine *m) {
    const zl_records *records = m->records;
    const int records_all = (int)m->run->settings.records;
    return records->n_events + ZL_AT_ONCE(m->graph->n_stops, m->graph->n_declared) < records->most_events &&
           (!records_all || (records->n_arcs + 2 < records->most_arcs &&
                             records->n_steps < records->most_steps &&
                             records->n_polynomials < records->most_polynomials));
}
