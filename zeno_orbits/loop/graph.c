/* The event machine over a graph of modes, of stops, switches and kinks: `ReferenceRun` in Python.

   A run looks at one stop at a time. The stops that are closed beside it are constraints of both its
   flows. Sets of stops and of switches are bits. */

#define BIT(k) (1LL << (k))

enum { LOCKED_ARC, FREE_ARC, FLIGHT_ARC, HOP_ARC };

/* A run over a graph, its present view, and the guards beside its stop. */
typedef struct {
    Machine m;
    Others others;
    const zl_problem *whole;
    int asks; /* for a view or side that the tables do not have; what follows is repeated */
    long long asked[4]; /* the first question, as the status `ZL_MODE` tells it */
} Graph;

/* Tables. */

static long long place_of(const long long *keys, long long n, long long key) {
    long long k;
    for (k = 0; k < n; k++)
        if (keys[k] == key) return k;
    return -1;
}

static void ask(Graph *g, int is_side, long long mode, long long index, long long positive) {
    if (g->asks) return;
    g->asks = 1;
    g->asked[0] = is_side;
    g->asked[1] = mode;
    g->asked[2] = index;
    g->asked[3] = positive;
}

static Machine view_by_place(Graph *g, long long place) {
    return machine_of_view(g->whole, g->m.run, g->m.records, place);
}

/* The machine of an open stop in a mode. */
static Machine view_at(Graph *g, long long closed, long long sides, int stop) {
    const zl_graph *graph = g->whole->graph;
    const long long mode = ZL_MODE_KEY(closed, sides);
    const long long place = place_of(graph->view_keys, graph->n_views, ZL_VIEW_KEY(mode, stop));
    if (place < 0) ask(g, 0, mode, stop, 0);
    return view_by_place(g, place < 0 ? 0 : place);
}

/* The machine in which a closed stop of a mode is the stop: its locked flow is that of the mode. */
static Machine holding(Graph *g, long long closed, int stop) {
    return view_at(g, closed & ~BIT(stop), g->m.run->graph.sides, stop);
}

/* Gap and gap rate of a stop, which are the same in every mode. */
static void gap_of(Graph *g, int stop, const double *x, double *gap) {
    const zl_graph *graph = g->whole->graph;
    long long k = 0;
    Machine m;
    while (k < graph->n_views && (graph->view_keys[k] & 31) != stop) k++;
    m = k < graph->n_views ? view_by_place(g, k) : view_at(g, 0, g->m.run->graph.sides, stop);
    evaluate_at(&m, ZL_GAP, x, gap);
}

static const zl_settings *settings_of(const Graph *g, int stop) {
    return settings_at(g->m.run) + stop;
}

/* Formulas that all views share. */
static void shared(const Graph *g, const zl_tape *tape, long long place, const double *given,
                   double *told) {
    tape_run(tape, numbers_at(g->whole, g->m.run) + place, given, told);
}

/* The closed stops of the arc that starts. */
static long long closed_at_start(const Graph *g) {
    const zl_run *run = g->m.run;
    return run->graph.rest | (run->start.mode == ZL_LOCKED ? BIT(run->graph.focus) : 0);
}

/* The sides of the kinks, and with dry friction the closed stops, for the formulas of switches. */
static void give_sides(const Graph *g, double *given) {
    const zl_graph *graph = g->whole->graph;
    const long long n = graph->n_switches - graph->n_declared, closed = closed_at_start(g);
    long long k;
    for (k = 0; k < n; k++) given[k] = (double)(g->m.run->graph.sides >> k & 1);
    if (!graph->n_frictional) return;
    for (k = 0; k < graph->n_stops; k++) given[n + k] = (double)(closed >> k & 1);
}

/* The formulas of all switches at a state on the present sides of the kinks, their rounding levels,
   `armed`, and with dry friction where they occur without a zero. */
static void switches_due(const Graph *g, const double *x, double *formulas, double *levels,
                         double *armed, double *due) {
    const zl_graph *graph = g->whole->graph;
    const long long n_x = g->whole->n_x, n = graph->n_switches;
    double given[2 * ZL_MOST + ZL_GUARDS + ZL_STOPS], told[4 * ZL_GUARDS];
    long long k;
    if (!n) return;
    for (k = 0; k < n_x; k++) {
        given[k] = x[k];
        given[n_x + k] = settings_of(g, 0)->sizes[k] + fabs(x[k]);
    }
    give_sides(g, given + 2 * n_x);
    shared(g, &graph->switches, graph->switches_place, given, told);
    for (k = 0; k < n; k++) {
        formulas[k] = told[k];
        levels[k] = SWITCH_ZERO * told[n + k];
    }
    if (armed) memcpy(armed, told + 2 * n, (size_t)graph->n_declared * sizeof(double));
    if (due && graph->n_frictional)
        memcpy(due, told + 2 * n + graph->n_declared, (size_t)graph->n_declared * sizeof(double));
}

static void switches_at(const Graph *g, const double *x, double *formulas, double *levels,
                        double *armed) {
    switches_due(g, x, formulas, levels, armed, 0);
}

/* Modes. */

static void adopt(Graph *g, long long view) {
    zl_run *run = g->m.run;
    run->graph.view = view;
    g->m = view_by_place(g, view);
    g->m.others = &g->others;
    run->settings = *g->m.settings;
    run->small_gap = run->settings.contact * run->settings.gap;
    run->small_rate = run->settings.contact * run->settings.gap_rate;
}

/* Look at a stop, with others closed beside it. */
static void look(Graph *g, long long rest, int focus) {
    Graphed *graph = &g->m.run->graph;
    Machine m = view_at(g, rest, graph->sides, focus);
    graph->rest = rest;
    graph->focus = focus;
    adopt(g, m.problem - g->whole->graph->views);
}

static int focus_of(const Graph *g) { return (int)g->m.run->graph.focus; }

static int is_above(const Graph *g, int k) {
    const Graphed *graph = &g->m.run->graph;
    const int n = (int)g->whole->graph->n_declared;
    return (int)((k < n ? graph->above >> k : graph->sides >> (k - n)) & 1);
}

/* Take the side of every kink anew, each on the sides of the kinks before it. A zero keeps the side,
   and so does the kink that has just been crossed, if there is one. */
static void take_kinks(Graph *g, const double *x, int crossed) {
    const int first = (int)g->whole->graph->n_declared, n = (int)g->whole->graph->n_switches;
    long long taken = crossed < 0 ? 0 : BIT(crossed);
    int k;
    do {
        double formulas[ZL_GUARDS], levels[ZL_GUARDS];
        switches_at(g, x, formulas, levels, 0);
        for (k = first; k < n; k++)
            if (!(taken & BIT(k)) && fabs(formulas[k]) > levels[k] &&
                (formulas[k] > 0.0) != is_above(g, k))
                break;
        if (k == n) return;
        /* Later conditions may depend on this one, and so may the use of earlier ones. */
        g->m.run->graph.sides ^= BIT(k - first);
        taken |= BIT(k);
    } while (1);
}

/* Go to the other side of a switch. Conditions that depend on a kink may change as well. */
static void change_side(Graph *g, int k, const double *x) {
    Graphed *graph = &g->m.run->graph;
    const int n = (int)g->whole->graph->n_declared;
    if (k < n) {
        graph->above ^= BIT(k);
        return;
    }
    graph->sides ^= BIT(k - n);
    take_kinks(g, x, k);
}

/* Take the side of every switch at a state. A zero keeps the side of a kink, and is above. */
static void take_sides(Graph *g, const double *x) {
    const int n = (int)g->whole->graph->n_declared;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS];
    int k;
    switches_at(g, x, formulas, levels, 0);
    g->m.run->graph.above = 0;
    for (k = 0; k < n; k++)
        if (!(formulas[k] < -levels[k])) g->m.run->graph.above |= BIT(k);
    take_kinks(g, x, -1);
}

/* Guards beside the stop. */

static void formulas_of_side(Graph *g, long long mode, int k, int positive, Other *other) {
    const zl_graph *graph = g->whole->graph;
    long long place = place_of(graph->side_keys, graph->n_sides, ZL_SIDE_KEY(mode, k, positive));
    const zl_side *side;
    double *numbers;
    if (place < 0) {
        ask(g, 1, mode, k, positive);
        return;
    }
    side = &graph->sides[place];
    numbers = numbers_at(g->whole, g->m.run) + side->place;
    other->value = &side->value;
    other->bounds = &side->bounds;
    other->registers = numbers + 1;
    other->bounds_registers = numbers + 1 + side->value.n_registers;
    if (numbers[0] == 0.0) {
        const double *p = parameters_at(graph, g->m.run);
        tape_prepare(other->value, other->registers, p);
        intervals_prepare(other->bounds, other->bounds_registers, p);
        numbers[0] = 1.0;
    }
}

static void formulas_of_mode(const Machine *m, int mode, Other *other) {
    other->value = &m->problem->tapes[ZL_GUARD + mode];
    other->bounds = &m->problem->tapes[ZL_WATCHED + mode];
    other->registers = m->registers[ZL_GUARD + mode];
    other->bounds_registers = m->registers[ZL_WATCHED + mode];
}

/* Find the guards of the arc that starts: closed stops, open stops, declared switches, kinks. */
static void find_others(Graph *g) {
    const zl_graph *graph = g->whole->graph;
    const Graphed *now = &g->m.run->graph;
    const long long closed = closed_at_start(g);
    Other *other = g->others.list;
    int k;
    for (k = 0; k < graph->n_stops; k++) {
        Machine m;
        if (!(now->rest & BIT(k))) continue;
        m = holding(g, closed, k);
        other->kind = ZL_RELEASE;
        other->index = k;
        formulas_of_mode(&m, ZL_LOCKED, other++);
    }
    for (k = 0; k < graph->n_stops; k++) {
        Machine m;
        if ((closed | BIT(now->focus)) & BIT(k)) continue;
        m = view_at(g, closed, now->sides, k);
        other->kind = ZL_IMPACT;
        other->index = k;
        formulas_of_mode(&m, ZL_FREE, other++);
    }
    for (k = 0; k < graph->n_switches; k++) {
        if (k < graph->n_declared && graph->causes[k] >= 0) continue;
        other->kind = ZL_SWITCH;
        other->index = k;
        other->sign = is_above(g, k) ? 1.0 : -1.0;
        formulas_of_side(g, ZL_MODE_KEY(closed, now->sides), k, is_above(g, k), other++);
    }
    g->others.n = (int)(other - g->others.list);
}

/* The gap that rounding may take from a flight with a gap rate. */
static double lost_by_rounding(double rate, const zl_settings *settings) {
    return LOST * (rate * rate / settings->gap_acceleration);
}

/* Whether a stop was struck or opened at the start, so that its gap is zero. */
static int is_met(const zl_run *run, int stop) {
    return run->graph.met_times[stop] == run->start.time;
}

/* The rounding of a gap by the rounding of its states. */
static double rounding_of_states(Graph *g, int stop, const double *x) {
    double moved[ZL_MOST], gap[2], other[2], sum = 0.0;
    long long k;
    gap_of(g, stop, x, gap);
    memcpy(moved, x, (size_t)g->whole->n_x * sizeof(double));
    for (k = 0; k < g->whole->n_x; k++) {
        moved[k] += ROUNDING * x[k];
        gap_of(g, stop, moved, other);
        sum += fabs(other[0] - gap[0]);
        moved[k] = x[k];
    }
    return sum;
}

/* The rounding of a gap: of its states, what an event left at the stop, and the height of a flight
   that lasts for the rounding of its time. */
static double rounding_of_gap(Graph *g, int stop, const double *x) {
    const double left = LEFT_GAP * fabs(g->m.run->graph.met_gaps[stop]);
    const double least = ROUNDING * ROUNDING * settings_of(g, stop)->gap;
    return greater(greater(rounding_of_states(g, stop, x), left), least);
}

/* Whether a flight at a state has left its gap of zero. At its top the gap alone shows it. */
static int is_under_way(Graph *g, int stop, const double *gap, const double *x) {
    const zl_settings *settings = settings_of(g, stop);
    return gap[0] > 0.0 && (fabs(gap[1]) > settings->contact * settings->gap_rate ||
                            gap[0] > rounding_of_gap(g, stop, x));
}

/* Take all guards at the start of an arc; 0 unless each is above its rounding, or a switch on zero. */
static int take_guards(Graph *g) {
    zl_run *run = g->m.run;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS];
    int k, is_clear = 1;
    run->graph.undefined = -1;
    switches_at(g, run->start.state, formulas, levels, 0);
    for (k = 0; k < g->others.n; k++) {
        const Other *other = &g->others.list[k];
        const zl_settings *settings = settings_of(g, other->kind == ZL_SWITCH ? 0 : other->index);
        const double contact = settings->contact;
        Watched *watched = &run->watched[k];
        double value;
        int has_left = 0;
        pair_in_leg(&g->m, k, run->leg.y, watched->before);
        value = watched->before[0];
        watched->largest_change = watched->launched = watched->height = 0.0;
        watched->outcome = NO_FALL;
        if (other->kind == ZL_RELEASE) {
            watched->rounding = contact * settings->multiplier;
        } else if (other->kind == ZL_IMPACT) {
            double gap[2], lost;
            const int in_turns = come_in_turn(&run->graph);
            int moves;
            gap_of(g, other->index, run->start.state, gap);
            value = gap[0];
            watched->rounding = contact * settings->gap;
            lost = lost_by_rounding(gap[1], settings);
            moves = fabs(gap[1]) > contact * settings->gap_rate;
            if (value <= watched->rounding && moves && gap[1] > 0.0 &&
                (in_turns || is_met(run, other->index) ||
                 value <= rounding_of_gap(g, other->index, run->start.state))) {
                watched->launched = gap[1];
                watched->rounding = contact / settings->gap_acceleration;
                if (in_turns && !is_met(run, other->index))
                    watched->height =
                        greater(value - run->graph.met_gaps[other->index], 0.0) / (gap[1] * gap[1]);
                is_clear = 0;
            } else if (in_turns && value > lost) {
                /* Its flight is under way. */
                watched->rounding = lesser(watched->rounding, lost);
            } else if (is_under_way(g, other->index, gap, run->start.state)) {
                has_left = 1;
            }
        } else {
            watched->rounding = levels[other->index];
            value = other->sign * formulas[other->index];
            if (isnan(value) && run->graph.undefined < 0) run->graph.undefined = other->index;
        }
        watched->on_guard =
            watched->launched > 0.0 || (value <= watched->rounding && !has_left);
        watched->began_on_guard = watched->on_guard;
        if (other->kind == ZL_SWITCH && watched->on_guard ? !(value >= -watched->rounding)
                                                          : !(value > watched->rounding))
            is_clear = 0;
    }
    return is_clear;
}

/* Errors. */

/* A flow that is singular at a time, and a kink that is zero there. */
static int is_singular(Graph *g, int status, double time) {
    zl_detail *detail = &g->m.run->detail;
    const zl_graph *graph = g->whole->graph;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS];
    long long k;
    detail->time = time;
    detail->index = -1;
    switches_at(g, detail->state, formulas, levels, 0);
    for (k = graph->n_switches - 1; k >= graph->n_declared; k--)
        if (fabs(formulas[k]) <= NEAR_KINK * levels[k]) detail->index = k;
    return status;
}

/* A state that leaves the admissible set where a kink is zero slides, as by dry friction at rest. */
static int penetrates(Graph *g, int status) {
    zl_detail *detail = &g->m.run->detail;
    const zl_graph *graph = g->whole->graph;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS], x[ZL_MOST];
    long long k;
    memcpy(x, detail->state, sizeof x);
    if (is_in_corner(&g->m)) return in_turn(&g->m, detail->time, x);
    switches_at(g, x, formulas, levels, 0);
    for (k = graph->n_declared; k < graph->n_switches; k++)
        if (fabs(formulas[k]) <= SPENT * levels[k]) return tell(&g->m, ZL_SLIDES, detail->time, x, k);
    return status;
}

static int coincide(const Graph *g, int kind, long long index, int other_kind, long long other,
                    double time, const double *x) {
    const long long about[4] = {kind, index, other_kind, other};
    memcpy(g->m.run->detail.about, about, sizeof about);
    return tell(&g->m, ZL_COINCIDE, time, x, index);
}

/* Arcs. */

static int begin_arc(Graph *g, int kind) {
    Graphed *graph = &g->m.run->graph;
    graph->kind = kind;
    graph->window = has_others(&g->m) ? g->m.run->pace.window : INFINITY;
    graph->careful = !has_others(&g->m);
    graph->retried = 0;
    g->m.run->stage = LAUNCHES;
    return GO_ON;
}

/* Start the leg of an arc, within the present window. */
static int launch(Graph *g) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    const zl_settings *settings = &run->settings;
    const double *x = run->start.state;
    const double contact = settings->contact;
    double gap[2];
    int status = GO_ON;
    graph->pace = run->pace;
    graph->found = -1;
    graph->limit = lesser(settings->until, run->start.time + graph->window);
    if (!graph->retried && graph->limit >= settings->until - late_in(&g->m))
        graph->limit = settings->until;
    run->in_hop = graph->kind == HOP_ARC;
    find_others(g);
    if (g->asks) return GO_ON;
    switch (graph->kind) {
    case LOCKED_ARC:
        status = start_leg_at(&g->m, ZL_LOCKED, 1.0, 1.0, contact * settings->multiplier,
                              settings->absolute, is_slack(&g->m, x, number_at(&g->m, ZL_LIFT, x)),
                              graph->limit);
        break;
    case FREE_ARC:
        evaluate_at(&g->m, ZL_GAP, x, gap);
        status = start_leg_at(&g->m, ZL_FREE, 1.0, 1.0, contact * settings->gap, settings->absolute,
                              gap[0] <= run->small_gap && !is_under_way(g, focus_of(g), gap, x),
                              graph->limit);
        break;
    case FLIGHT_ARC:
        if (run->start.height > 0.0) run->start.lift = number_at(&g->m, ZL_LIFT, x);
        status = start_leg_at(&g->m, ZL_FLIGHT, run->start.speed, run->start.launch,
                              contact * (1 / settings->gap_acceleration), flight_error(run),
                              run->start.height <= contact / settings->gap_acceleration,
                              graph->limit);
        break;
    default:
        run->start.height = graph->hop.height;
        status = start_leg_at(&g->m, ZL_FLIGHT, graph->hop.duration, graph->hop.launch, 0.0,
                              graph->hop.error, 1, graph->limit);
    }
    if (!take_guards(g)) graph->careful = 1;
    if (status == GO_ON) return GO_ON;
    graph->outcome = status;
    run->stage = ENDED;
    return GO_ON;
}

/* Go on from the start of an arc that left the admissible set: `StopRun.locked_arc` and others. */
static int leave_arc(Graph *g) {
    zl_run *run = g->m.run;
    const int kind = (int)run->graph.kind;
    if (kind == FLIGHT_ARC) return ZL_LEFT;
    if (kind != HOP_ARC || run->graph.hop.comes_first) run->first_detail = run->detail;
    if (kind == FREE_ARC) {
        run->graph.hop = small_hop(&g->m);
        if (run->graph.hop.duration != 0.0) return begin_arc(g, HOP_ARC);
    }
    return start_other_mode(&g->m, kind == LOCKED_ARC ? ZL_FREE : ZL_LOCKED);
}

/* A step failed: look for the event of another guard before that. */
static int step_failed_at(Graph *g, int status) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    const double unit = run->graph.in_side ? run->main.unit : run->leg.unit;
    const double reached = unit * run->detail.time;
    graph->in_side = 0;
    if (graph->retried) {
        run->detail.index = -1;
        return status;
    }
    if (!has_others(&g->m) || !(0.0 < reached && reached <= graph->window))
        return is_singular(g, status, run->start.time + reached);
    graph->window = reached * (1.0 - PART_BEFORE);
    graph->retried = 1;
    graph->first_status = status;
    graph->failed = run->detail;
    graph->failed.time = run->start.time + reached;
    run->stage = LAUNCHES;
    return GO_ON;
}

/* Whether a guard falls through zero here, to rounding. */
static int is_zero(const Graph *g, const double *pair, double rounding) {
    return pair[1] < 0.0 && pair[0] <= greater(rounding, -pair[1] * APART * g->m.run->settings.time);
}

/* The rounding of the times of two events [s]. */
static double rounding_of_time(const Graph *g) {
    return AT_ONCE * (g->m.run->settings.time + g->m.run->start.time);
}

/* Whether a gap falls through zero at a state, to its rounding. Where impacts come in turn,
   `is_resolved` decides about larger gaps. */
static int closes(Graph *g, int stop, const double *gap, const double *x, double largest) {
    if (!(gap[1] < 0.0) || gap[0] > largest || come_in_turn(&g->m.run->graph))
        return is_zero(g, gap, largest);
    return is_zero(g, gap, lesser(largest, rounding_of_gap(g, stop, x)));
}

/* Whether the surfaces of two kinks touch along closed stops. */
static int is_one_along(Graph *g, const Other *one, const Other *other, const double *x,
                        long long closed) {
    const zl_graph *graph = g->whole->graph;
    double a[2], b[2], largest = 0.0, difference = 0.0;
    long long k;
    tape_run(one->value, one->registers, x, a);
    tape_run(other->value, other->registers, x, b);
    for (k = 0; k < g->whole->n_x; k++) {
        const double shift = SHIFT * (settings_of(g, 0)->sizes[k] + fabs(x[k]));
        double first = 0.0, second = 0.0;
        int j, sign;
        /* The clock has one direction, which the rates contain. */
        if (graph->first_clock <= k && k < graph->end_clock) continue;
        for (sign = 1; sign >= -1; sign -= 2) {
            double moved[ZL_MOST], pair[2];
            memcpy(moved, x, sizeof moved);
            moved[k] += sign * shift;
            for (j = 0; j < graph->n_stops; j++)
                if (closed & BIT(j)) {
                    const Machine m = holding(g, closed, j);
                    to_stop(&m, moved, moved);
                }
            tape_run(one->value, one->registers, moved, pair);
            first += sign * pair[0];
            tape_run(other->value, other->registers, moved, pair);
            second += sign * pair[0];
        }
        first *= b[1];
        second *= a[1];
        largest = greater(largest, fabs(first));
        difference = greater(difference, fabs(first - second));
    }
    return difference <= ONE_SURFACE * largest;
}

/* Whether the surfaces of two kinks touch at a state where both fall, so that their slopes, or those
   along the closed stops, are in the ratio of their rates. The order of both events then has no effect to
   first order. */
static int is_one_surface(Graph *g, const Other *one, const Other *other, const double *x) {
    const zl_graph *graph = g->whole->graph;
    const long long n_x = g->whole->n_x, n = graph->n_switches, closed = closed_at_start(g);
    double given[2 * ZL_MOST + ZL_GUARDS + ZL_STOPS], told[4 * ZL_GUARDS], a[2], b[2];
    double largest = 0.0, difference = 0.0;
    long long k;
    tape_run(one->value, one->registers, x, a);
    tape_run(other->value, other->registers, x, b);
    memcpy(given, x, (size_t)n_x * sizeof(double));
    for (k = 0; k < n_x; k++) given[n_x + k] = 0.0;
    give_sides(g, given + 2 * n_x);
    for (k = 0; k < n_x; k++) {
        double first, second;
        /* The clock has one direction, which the rates contain. */
        if (graph->first_clock <= k && k < graph->end_clock) continue;
        given[n_x + k] = settings_of(g, 0)->sizes[k] + fabs(x[k]);
        shared(g, &graph->switches, graph->switches_place, given, told);
        given[n_x + k] = 0.0;
        first = fabs(told[n + one->index] * b[1]);
        second = fabs(told[n + other->index] * a[1]);
        largest = greater(largest, first);
        difference = greater(difference, fabs(first - second));
    }
    return difference <= ONE_SURFACE * largest || (closed && is_one_along(g, one, other, x, closed));
}

static int is_kink(const Graph *g, const Other *other) {
    return other->kind == ZL_SWITCH && other->index >= g->whole->graph->n_declared;
}

/* The first kink that falls where a kink fell, on one surface: both are crossed by one event. */
static const Other *first_of_surface(Graph *g, const Other *fell, const double *x) {
    const Other *other;
    if (!is_kink(g, fell)) return fell;
    for (other = g->others.list; other != fell; other++) {
        const Watched *watched = &g->m.run->watched[other - g->others.list];
        double pair[2];
        if (!is_kink(g, other) || watched->began_on_guard) continue;
        tape_run(other->value, other->registers, x, pair);
        if (is_zero(g, pair, watched->rounding) && is_one_surface(g, other, fell, x)) return other;
    }
    return fell;
}

/* Whether a kink is crossed by the event of the kink that fell. */
static int is_on_surface_of_found(Graph *g, const Other *other, const double *x) {
    const long long found = g->m.run->graph.found;
    const Other *fell = found < 0 ? 0 : &g->others.list[found];
    return fell && is_kink(g, fell) && is_kink(g, other) && is_one_surface(g, other, fell, x);
}

/* Whether an impulse on one of two stops changes the gap rate of the other. */
static int are_coupled(const double *all, int n_stops, int j, int k) {
    const double size = sqrt(all[j * n_stops + j] * all[k * n_stops + k]);
    return fabs(all[j * n_stops + k]) > COUPLED * size;
}

/* Refuse impacts at one time on stops that are coupled, directly or by closed stops. */
static int require_apart(Graph *g, long long struck, long long closed, double time,
                         const double *x) {
    const zl_graph *graph = g->whole->graph;
    const int n = (int)graph->n_stops;
    double all[ZL_STOPS * ZL_STOPS];
    int first, j, k;
    if (!(struck & (struck - 1))) return GO_ON;
    shared(g, &graph->delassus, graph->delassus_place, x, all);
    for (first = 0; first < n; first++) {
        long long reached = BIT(first), before = 0;
        if (!(struck & BIT(first))) continue;
        struck &= ~BIT(first);
        while (reached != before) {
            before = reached;
            for (k = 0; k < n; k++)
                for (j = 0; j < n && ((closed | struck) & BIT(k)) && !(reached & BIT(k)); j++)
                    if ((before & BIT(j)) && are_coupled(all, n, j, k)) reached |= BIT(k);
        }
        for (k = 0; k < n; k++)
            if (struck & reached & BIT(k))
                return coincide(g, ZL_IMPACT, first, ZL_IMPACT, k, time, x);
    }
    return GO_ON;
}

/* Whether the zero of a guard is an event: a declared switch is armed and falls. */
static int occurs(const Graph *g, int kind, long long index, const double *x) {
    double formulas[ZL_GUARDS], levels[ZL_GUARDS], armed[ZL_GUARDS];
    if (kind != ZL_SWITCH || index >= g->whole->graph->n_declared) return 1;
    if (!is_above(g, (int)index)) return 0;
    switches_at(g, x, formulas, levels, armed);
    return armed[index] > 0.0;
}

/* Whether the present arc is a flight from the stop, whose scaled gap and its rate are exact at its end
   if the flight of no other stop ends it. */
static int is_scaled(const Graph *g) {
    const Graphed *graph = &g->m.run->graph;
    return graph->kind == FLIGHT_ARC &&
           !(graph->found >= 0 && g->m.run->watched[graph->found].launched > 0.0);
}

/* Whether the guard of the stop that the run looks at falls through zero at the end of an arc. */
static int main_is_zero(Graph *g, int main, const double *x) {
    const zl_run *run = g->m.run;
    double pair[2];
    if (is_scaled(g)) {
        const zl_settings *settings = &run->settings;
        const double *scaled = run->leg.end + g->whole->n_x;
        const double apart =
            lesser(APART * settings->time / run->leg.unit, OF_FLIGHT * run->leg.duration);
        return scaled[1] < 0.0 &&
               scaled[0] <= greater(settings->contact / settings->gap_acceleration,
                                    -scaled[1] * apart);
    }
    if (main == ZL_RELEASE) {
        evaluate_at(&g->m, ZL_GUARD + ZL_LOCKED, x, pair);
        return is_zero(g, pair, run->settings.contact * run->settings.multiplier);
    }
    evaluate_at(&g->m, ZL_GAP, x, pair);
    return closes(g, focus_of(g), pair, x, run->small_gap);
}

/* Whether stops open on the other side of a kink as well, which falls with them. The flow does not
   change at a release, so their order has no effect if no stop is pressed beyond the kink. */
static int opens_beyond(Graph *g, int kink, long long stops, double const *x) {
    Graphed *graph = &g->m.run->graph;
    const long long sides = graph->sides, closed = closed_at_start(g);
    const int n = (int)g->whole->graph->n_stops;
    int k, all_open = 1;
    change_side(g, kink, x);
    for (k = 0; k < n && all_open; k++) {
        const zl_settings *settings = settings_of(g, k);
        const double rounding = settings->contact * settings->multiplier;
        double pair[2];
        Machine m;
        if (!(stops & BIT(k))) continue;
        m = holding(g, closed, k);
        evaluate_at(&m, ZL_GUARD + ZL_LOCKED, x, pair);
        all_open = is_zero(g, pair, rounding) || pair[0] < -rounding;
    }
    graph->sides = sides;
    return all_open;
}

/* Whether each of some stops opens after each of the others has opened. The flow does not change at a
   release, but the rates of the other contact forces may. */
static int open_in_any_order(Graph *g, long long stops, const double *x) {
    const long long closed = closed_at_start(g);
    const int n = (int)g->whole->graph->n_stops;
    int first, k;
    for (first = 0; first < n; first++)
        for (k = 0; k < n && (stops & BIT(first)); k++) {
            const zl_settings *settings = settings_of(g, k);
            double pair[2];
            Machine m;
            if (k == first || !(stops & BIT(k))) continue;
            m = holding(g, closed & ~BIT(first), k);
            evaluate_at(&m, ZL_GUARD + ZL_LOCKED, x, pair);
            if (!is_zero(g, pair, settings->contact * settings->multiplier)) return 0;
        }
    return 1;
}

/* The flow of the mode that the present sides and some closed stops have, at a state. */
static void flow_at(Graph *g, long long closed, const double *x, double *rate) {
    int k = (int)g->whole->graph->n_stops - 1;
    Machine m;
    while (k >= 0 && !(closed & BIT(k))) k--;
    m = k < 0 ? view_at(g, 0, g->m.run->graph.sides, focus_of(g)) : holding(g, closed, k);
    evaluate_at(&m, ZL_RATE + (k < 0 ? ZL_FREE : ZL_LOCKED), x, rate);
}

/* Whether kinks that fall together leave the flow as it is, each alone and all of them. Their order then
   has no effect. */
static int leave_flow(Graph *g, long long kinks, long long closed, const double *x) {
    Graphed *graph = &g->m.run->graph;
    const zl_settings *settings = settings_of(g, 0);
    const long long sides = graph->sides;
    const int first = (int)g->whole->graph->n_declared, n = (int)g->whole->graph->n_switches;
    double before[ZL_MOST], after[ZL_MOST];
    int k, alone, same = 1;
    long long i;
    flow_at(g, closed, x, before);
    for (alone = 1; alone >= 0; alone--) {
        for (k = first; k < n; k++) {
            if (!(kinks & BIT(k))) continue;
            change_side(g, k, x);
            flow_at(g, closed, x, after);
            for (i = 0; i < g->whole->n_x; i++)
                if (!(fabs(after[i] - before[i]) <=
                      SAME * (settings->sizes[i] / settings->time + fabs(before[i]))))
                    same = 0;
            if (alone) graph->sides = sides;
        }
    }
    graph->sides = sides;
    return same;
}

/* Whether a gap that counts as zero closes at that time: where impacts come on several stops in turn,
   its rounding may close it too early. */
static int is_resolved(const Graph *g, const double *gap) {
    const zl_run *run = g->m.run;
    return !(come_in_turn(&run->graph) &&
             gap[0] > greater(-gap[1] * APART * run->settings.time,
                              lost_by_rounding(gap[1], &run->settings)));
}

/* Whether a stop that is not coupled to a struck one is struck at the same time, to its rounding. Each
   keeps its own time otherwise: to strike it too early would shift all its later impacts. */
static int closes_now(Graph *g, int stop, const double *gap, const double *x) {
    return gap[1] < 0.0 &&
           gap[0] <= greater(rounding_of_gap(g, stop, x), -gap[1] * rounding_of_time(g));
}

/* The same of the stop that the run looks at. */
static int main_closes_now(Graph *g, const double *x) {
    double pair[2];
    if (is_scaled(g)) {
        const double *scaled = g->m.run->leg.end + g->whole->n_x;
        return scaled[0] <= -scaled[1] * rounding_of_time(g) / g->m.run->leg.unit;
    }
    evaluate_at(&g->m, ZL_GAP, x, pair);
    return closes_now(g, focus_of(g), pair, x);
}

/* Whether two stops are coupled, directly or by closed stops. */
static int are_tied(Graph *g, long long one, long long other, const double *x) {
    return require_apart(g, BIT(one) | BIT(other), closed_at_start(g), g->m.run->start.time, x) !=
           GO_ON;
}

/* Find the event at the end of an arc, of all events whose guards are zero there: its place in the
   list of the others, or -1 for the stop that the run looks at. A switch that is not armed, or rises,
   is no event. A kink changes no state, and an impact does not depend on it. Impacts on stops that
   are not coupled change nothing for each other, nor do kinks that leave the flow as it is, nor stops
   that open in every order. A kink comes before a release that takes place on both of its sides. */
static int event_at_end(Graph *g, int main, double time, const double *x, long long *chosen) {
    const zl_run *run = g->m.run;
    const zl_graph *graph = g->whole->graph;
    const long long found = run->graph.found, focus = run->graph.focus;
    long long places[ZL_GUARDS + 1], kinds[ZL_GUARDS + 1], indices[ZL_GUARDS + 1];
    long long struck = 0, opened = 0, switches = 0;
    int n = 0, k, all_commute = 1, first = -1, n_switches = 0, kink = -1;
    g->m.run->graph.together = 0;
    for (k = -2; k <= g->others.n; k++) {
        /* What fell comes first, the stop that the run looks at last. */
        const long long place = k == -2 ? found : k == g->others.n ? -1 : k;
        const Other *other = place >= 0 ? &g->others.list[place] : 0;
        double pair[2];
        if (k == -1 || (k != -2 && place == found)) continue;
        if (k == -2) {
            *chosen = found;
        } else if (!other) {
            if (!main_is_zero(g, main, x)) continue;
            if (n && kinds[0] == ZL_IMPACT && main == ZL_IMPACT &&
                !are_tied(g, indices[0], focus, x) && !main_closes_now(g, x))
                continue;
        } else {
            const Watched *watched = &run->watched[place];
            if (watched->began_on_guard && other->kind != ZL_IMPACT) continue;
            if (other->kind == ZL_IMPACT)
                gap_of(g, other->index, x, pair);
            else
                tape_run(other->value, other->registers, x, pair);
            if (!(other->kind == ZL_IMPACT ? closes(g, other->index, pair, x, watched->rounding)
                                           : is_zero(g, pair, watched->rounding)))
                continue;
            if (n && kinds[0] == ZL_IMPACT && other->kind == ZL_IMPACT &&
                !are_tied(g, indices[0], other->index, x)) {
                if (!closes_now(g, other->index, pair, x)) continue;
            } else if (other->kind == ZL_IMPACT && !is_resolved(g, pair)) {
                return in_turn(&g->m, time, x);
            }
        }
        if (other && !occurs(g, other->kind, other->index, x)) continue;
        if (other && place != found && is_on_surface_of_found(g, other, x)) continue;
        places[n] = place;
        kinds[n] = other ? other->kind : main;
        indices[n] = other ? other->index : focus;
        if (kinds[n] == ZL_IMPACT) {
            if (first < 0 || indices[n] < indices[first]) first = n;
            struck |= BIT(indices[n]);
        } else if (kinds[n] != ZL_SWITCH || indices[n] < graph->n_declared) {
            all_commute = 0;
        }
        if (kinds[n] == ZL_RELEASE) opened |= BIT(indices[n]);
        if (kinds[n] == ZL_SWITCH) {
            n_switches++;
            switches |= BIT(indices[n]);
            kink = n;
        }
        n++;
    }
    if (n) *chosen = places[0];
    if (n < 2) return GO_ON;
    if (!struck && !n_switches && open_in_any_order(g, opened, x)) {
        g->m.run->graph.together = opened;
        return GO_ON;
    }
    if (!struck && n_switches == 1 && indices[kink] >= graph->n_declared &&
        opens_beyond(g, (int)indices[kink], opened, x)) {
        *chosen = places[kink];
        return GO_ON;
    }
    if (n_switches == n && all_commute && leave_flow(g, switches, closed_at_start(g), x))
        return GO_ON;
    if (first < 0 || !all_commute)
        return coincide(g, (int)kinds[0], indices[0], (int)kinds[1], indices[1], time, x);
    *chosen = places[first];
    return require_apart(g, struck, closed_at_start(g), time, x);
}

static int after_other(Graph *g, double time, const double *x, const Other *other,
                       const double *rate, const double *scaled);
static int on_other_side(Graph *g, int k);
static int release_all(Graph *g, double time, const double *x);
static int land_at(Graph *g, double time, const double *x, double rate);
static int meet_at(Graph *g, double time, const double *x, double rate);

/* See what the end of an arc leads to, once the guard that fell first is known. */
static int conclude(Graph *g) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    const zl_settings *settings = &run->settings;
    const long long n_x = g->whole->n_x;
    const int found = (int)graph->found, main = graph->kind == LOCKED_ARC ? ZL_RELEASE : ZL_IMPACT;
    const int at_limit = graph->outcome == LEG_AT_HORIZON && found < 0;
    const double begin = run->start.time, main_end = run->leg.duration;
    int kind = main, status = GO_ON;
    long long chosen = found;
    double x[ZL_MOST], time, rate = 0.0;
    const Other *other = found >= 0 ? &g->others.list[found] : 0;
    if (at_limit && graph->retried) {
        write_leg(&g->m, ZL_HORIZON, graph->limit);
        run->detail = graph->failed;
        return is_singular(g, (int)graph->first_status, graph->failed.time);
    }
    if (at_limit && graph->limit < settings->until) {
        graph->window *= GROW;
        graph->careful = 0;
        run->stage = LAUNCHES;
        return GO_ON;
    }
    if (other && run->watched[found].outcome == IS_LEFT) {
        const int at_end = graph->outcome == LEG_AT_HORIZON;
        if (!graph->careful) return on_other_side(g, other->index);
        time = at_end ? graph->limit : begin + run->leg.unit * main_end;
        run->pace.window = greater(GROW * (time - begin), SHORTEST * settings->time);
        return on_other_side(g, other->index);
    }
    if (other) {
        const Watched *watched = &run->watched[found];
        const int launches = watched->launched > 0.0;
        if (!launches) other = first_of_surface(g, other, watched->end);
        kind = other->kind;
        if (launches) {
            run->leg = run->side;
            rate = watched->launched * run->leg.end[n_x + 1];
        } else {
            run->leg.duration = watched->at;
            run->leg.n_steps = watched->n_steps;
            run->leg.n_polynomials = watched->n_polynomials;
            memcpy(run->leg.end, watched->end, sizeof watched->end);
        }
    }
    memcpy(x, run->leg.end, sizeof x);
    time = at_limit ? settings->until : begin + run->leg.unit * run->leg.duration;
    run->pace.window = greater(GROW * (time - begin), SHORTEST * settings->time);
    if (!at_limit) status = event_at_end(g, main, time, x, &chosen);
    if (chosen != found) kind = chosen < 0 ? main : g->others.list[chosen].kind;
    if (status == GO_ON && !other && graph->kind == FLIGHT_ARC && !at_limit &&
        x[n_x] > ABOVE * fabs(x[n_x + 1]) * run->leg.duration) {
        /* The way meets the stop where the scaled gap is unaware of it: it is flown again. */
        run->start.has_speed = 0;
        run->start.height = 0.0;
        run->start.launch = 1.0;
        return begin_arc(g, FREE_ARC);
    }
    if (other && run->watched[found].launched > 0.0) {
        const long long view = graph->view;
        const Machine side = view_at(g, closed_at_start(g), graph->sides, other->index);
        graph->view = side.problem - g->whole->graph->views;
        write_leg(&side, kind, time);
        graph->view = view;
    } else {
        write_leg(&g->m, at_limit ? ZL_HORIZON : kind, time);
    }
    if (status != GO_ON) return status;
    if (at_limit) {
        run->stage = OVER;
        return GO_ON;
    }
    if (chosen >= 0) {
        const int is_known = chosen == found && run->watched[found].launched > 0.0;
        const Other *last = chosen == found ? other : &g->others.list[chosen];
        return after_other(g, time, x, last, is_known ? &rate : 0, is_scaled(g) ? x + n_x : 0);
    }
    run->stage = AT_START;
    if (graph->kind == LOCKED_ARC) {
        if (other) graph->has_current = 0;
        return release_all(g, time, x);
    }
    if (graph->kind == FREE_ARC || (other && graph->kind == HOP_ARC) ||
        (other && run->watched[found].launched > 0.0)) {
        double gap[2];
        evaluate_at(&g->m, ZL_GAP, x, gap);
        return meet_at(g, time, x, gap[1]);
    }
    return land_at(g, time, x, run->leg.unit * x[n_x + 1]);
}

/* A switch that an arc leaves on its wrong side, if it ends in its first step; else -1. */
static int left_within(const Graph *g) {
    const zl_run *run = g->m.run;
    const int found = (int)run->graph.found;
    const double duration = run->graph.horizon * run->leg.unit;
    const double *end = run->leg.end;
    int k;
    if (found >= 0)
        end = run->watched[found].launched > 0.0 ? run->side.end : run->watched[found].end;
    for (k = 0; k < g->others.n; k++) {
        const Other *other = &g->others.list[k];
        const Watched *watched = &run->watched[k];
        double pair[2];
        if (k == found || other->kind != ZL_SWITCH || !watched->began_on_guard) continue;
        tape_run(other->value, other->registers, end, pair);
        if (pair[0] < -greater(LEAVES * fabs(pair[1]) * duration, watched->rounding)) return k;
    }
    return -1;
}

/* Go on to find the guard that falls first, of those that have been followed to their ends. */
static int decide(Graph *g) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    const double last = run->leg.horizon - run->leg.late;
    int k;
    while (graph->next_guard < g->others.n) {
        const Watched *watched;
        const Other *other;
        k = (int)graph->next_guard++;
        watched = &run->watched[k];
        other = &g->others.list[k];
        if (watched->launched > 0.0) {
            /* Another stop is just left: its flight is followed in rescaled time. */
            const Machine side = view_at(g, closed_at_start(g), graph->sides, other->index);
            double y[ZL_MOST];
            if (g->asks) return GO_ON;
            memcpy(y, run->start.state, sizeof y);
            y[g->whole->n_x] = watched->height;
            y[g->whole->n_x + 1] = 1.0;
            run->main = run->leg;
            run->in_hop = 0;
            graph->in_side = 1;
            run->leg.launch = 1.0;
            run->leg.height = watched->height;
            run->leg.on_guard = watched->height <= watched->rounding;
            run->leg.rounding = watched->rounding;
            run->stage = IN_SIDE;
            if (begin_leg(&side, ZL_FLIGHT, watched->launched, y,
                          graph->horizon * run->main.unit / watched->launched,
                          run->settings.relative, run->settings.absolute))
                return GO_ON;
            run->leg.time = 0.0;
            return step_failed_at(g, step_failed(run, ZL_NOT_FINITE));
        }
        if (watched->outcome == IS_LEFT && watched->until < graph->horizon) {
            if (other->kind == ZL_SWITCH) {
                graph->found = k;
                return conclude(g);
            }
            return tell(&g->m, ZL_LEFT, run->start.time + run->leg.unit * watched->at, watched->end,
                        0);
        }
        if (watched->outcome == FELL && watched->at < lesser(graph->horizon, last)) {
            graph->found = k;
            graph->horizon = watched->at;
        }
    }
    k = left_within(g);
    if (k >= 0) {
        run->watched[k].outcome = IS_LEFT;
        graph->found = k;
    }
    return conclude(g);
}

/* Take a step of the flight of another stop that is just left. */
static int step_aside(Graph *g) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    const int k = (int)graph->next_guard - 1;
    const Machine side = view_at(g, closed_at_start(g), graph->sides, g->others.list[k].index);
    const int outcome = step_leg(&side);
    if (outcome == LEG_GOES_ON) return GO_ON;
    if (outcome == ZL_LEFT) {
        graph->in_side = 0;
        return ZL_LEFT;
    }
    if (outcome != LEG_FELL && outcome != LEG_AT_HORIZON) return step_failed_at(g, outcome);
    graph->in_side = 0;
    if (outcome == LEG_FELL && run->leg.unit * run->leg.duration <
                                   run->main.unit * (run->main.horizon - run->main.late)) {
        graph->found = k;
        graph->horizon = run->leg.duration * (run->watched[k].launched / run->main.unit);
        run->side = run->leg;
        run->watched[k].outcome = FELL;
    }
    run->leg = run->main;
    run->stage = DECIDES;
    return GO_ON;
}

/* See how the leg of an arc ended. In doubt every guard is followed to its own end. */
static int arc_ended(Graph *g) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    const int outcome = (int)graph->outcome;
    const int is_over = outcome == LEG_FELL || outcome == LEG_AT_HORIZON;
    if (!graph->careful) {
        if (outcome == LEG_FELL_BESIDE || is_over) return conclude(g);
        run->pace = graph->pace;
        graph->careful = 1;
        run->stage = LAUNCHES;
        return GO_ON;
    }
    if (outcome == ZL_TOO_STIFF || outcome == ZL_SINGULAR || outcome == ZL_NOT_FINITE)
        return step_failed_at(g, outcome);
    if (!is_over) return outcome;
    if (graph->undefined >= 0)
        return tell(&g->m, ZL_UNDEFINED, run->start.time, run->start.state, graph->undefined);
    graph->horizon = run->leg.duration;
    graph->next_guard = 0;
    return decide(g);
}

/* Switches. */

/* The switches of dry friction. */
static long long frictional(const Graph *g) {
    const zl_graph *graph = g->whole->graph;
    return (BIT(graph->n_frictional) - 1) << (graph->n_declared - graph->n_frictional);
}

static int switched(Graph *g, double time, const double *x, int k, const double *scaled);
static int count_switch(Graph *g, double time, int k, const double *before, const double *after);

static int switched_at_start(Graph *g, int k) {
    double x[ZL_MOST];
    memcpy(x, g->m.run->start.state, sizeof x);
    return switched(g, g->m.run->start.time, x, k, 0);
}

/* The rate of a declared switch's guard along the flow that starts. */
static double guard_rate(Graph *g, int k, const double *x) {
    double pair[2];
    Other other;
    formulas_of_side(g, ZL_MODE_KEY(closed_at_start(g), g->m.run->graph.sides), k, 1, &other);
    if (g->asks) return 0.0;
    tape_run(other.value, other.registers, x, pair);
    return pair[1];
}

/* Whether a switch that is armed and falls at a start has not just occurred. */
static int occurs_at_once(Graph *g, int k, int *at_once) {
    const Graphed *graph = &g->m.run->graph;
    const zl_start *start = &g->m.run->start;
    const long long n = graph->n_row[k];
    *at_once = 0;
    if (!graph->has_events && start->time == 0.0) {
        const long long past = g->m.run->settings.past;
        if (past == -1 || past == k + 1) return GO_ON;
        return tell(&g->m, ZL_ARMED, start->time, start->state, k);
    }
    if (!(n && graph->row_times[k][n - 1] == start->time))
        *at_once = 1;
    else if (graph->last_switch != k)
        return tell(&g->m, ZL_ACCUMULATE, start->time, start->state, k);
    return GO_ON;
}

/* The switch of dry friction that is most urgently due, or -1. */
static int first_due(const Graph *g, const double *due, double least) {
    const zl_graph *graph = g->whole->graph;
    const int n = (int)graph->n_declared;
    int k = n - (int)graph->n_frictional, found = -1;
    for (; k < n; k++)
        if (due[k] >= least && (found < 0 || due[k] > due[found])) found = k;
    return found;
}

static int has_occurred(const Graph *g, int k, double time) {
    const Graphed *graph = &g->m.run->graph;
    const long long n = graph->n_row[k];
    return n && graph->row_times[k][n - 1] == time;
}

/* Apply the switches of dry friction that another one of them forces before stops open or close. */
static int settle(Graph *g, double time, double *x) {
    const zl_graph *table = g->whole->graph;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS], armed[ZL_GUARDS], due[ZL_GUARDS];
    long long turn;
    for (turn = 0; table->n_frictional && turn < table->n_declared; turn++) {
        double after[ZL_MOST];
        int k, status;
        switches_due(g, x, formulas, levels, armed, due);
        k = first_due(g, due, FORCED);
        if (k < 0 || has_occurred(g, k, time)) return GO_ON;
        shared(g, &table->resets[k], table->reset_places[k], x, after);
        status = count_switch(g, time, k, x, after);
        if (status != GO_ON) return status;
        take_sides(g, after);
        memcpy(x, after, (size_t)g->whole->n_x * sizeof(double));
    }
    return GO_ON;
}

/* Find the declared switch that occurs at a start, or -1: it is armed, and its guard falls. A switch
   that has just occurred goes over to its other side. */
static int find_due(Graph *g, int *due) {
    const int n = (int)g->whole->graph->n_declared;
    const double *x = g->m.run->start.state;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS], armed[ZL_GUARDS], forced[ZL_GUARDS];
    int k, at_once, status;
    *due = -1;
    if (!n) return GO_ON;
    switches_due(g, x, formulas, levels, armed, forced);
    k = first_due(g, forced, 1.0);
    if (k >= 0) {
        if (has_occurred(g, k, g->m.run->start.time))
            return tell(&g->m, ZL_ACCUMULATE, g->m.run->start.time, x, k);
        *due = k;
        return GO_ON;
    }
    /* The guards of dry friction depend on the closed stops. */
    for (k = n - (int)g->whole->graph->n_frictional; k < n; k++)
        if (formulas[k] < -levels[k])
            g->m.run->graph.above &= ~BIT(k);
        else
            g->m.run->graph.above |= BIT(k);
    for (k = 0; k < n; k++) {
        if (!(is_above(g, k) && fabs(formulas[k]) <= levels[k] && armed[k] > 0.0)) continue;
        if (!(guard_rate(g, k, x) < -levels[k] / g->m.run->settings.time)) continue;
        status = occurs_at_once(g, k, &at_once);
        if (status != GO_ON) return status;
        if (at_once) {
            *due = k;
            return GO_ON;
        }
        change_side(g, k, x);
    }
    return GO_ON;
}

/* The start on the other side of a switch, whose guard is zero at a start and falls. A declared
   switch occurs there if it is armed, unless it has just occurred. */
static int on_other_side(Graph *g, int k) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    const zl_start *start = &run->start;
    const double *x = start->state;
    if (graph->flipped_time != start->time) graph->flipped = 0;
    if (graph->flipped & BIT(k)) return tell(&g->m, ZL_SLIDES, start->time, x, k);
    graph->flipped |= BIT(k);
    graph->flipped_time = start->time;
    if (k < g->whole->graph->n_declared && occurs(g, ZL_SWITCH, k, x)) {
        int at_once, status = occurs_at_once(g, k, &at_once);
        if (status != GO_ON) return status;
        if (at_once) return switched_at_start(g, k);
        /* The guard rose by less than its rounding and fell again. */
        if (guard_rate(g, k, x) > 0.0) return tell(&g->m, ZL_ACCUMULATE, start->time, x, k);
        if (g->asks) return GO_ON;
    }
    change_side(g, k, x);
    look(g, graph->rest, focus_of(g));
    run->stage = AT_START;
    if (start->has_impact) {
        const size_t n_x = (size_t)g->whole->n_x;
        double told[2 * ZL_MOST + 1];
        evaluate_at(&g->m, ZL_RESTING, start->plus, told);
        memcpy(run->start.resting, told, n_x * sizeof(double));
        run->start.lift = told[n_x];
        memcpy(run->start.rate, told + n_x + 1, n_x * sizeof(double));
    }
    return GO_ON;
}

static int count_switch(Graph *g, double time, int k, const double *before, const double *after) {
    zl_run *run = g->m.run;
    const double none[3] = {0.0, 0.0, 0.0};
    write_event_of(&g->m, ZL_SWITCH, k, time, none, before, after);
    if (k < g->whole->graph->n_declared) {
        int status;
        run->graph.split_present |= BIT(k) & frictional(g);
        status = see_switch(&g->m, time, k, after);
        if (status != GO_ON) return status;
        /* A kink ends a step, so the limit of steps is its limit. */
        if (++run->graph.n_switches > run->settings.most_impacts)
            return tell(&g->m, ZL_MANY_SWITCHES, time, after, k);
    }
    return GO_ON;
}

/* Refuse a kink that changes the acceleration of the gap in every flight. */
static int require_continuous(Graph *g, int k, double time, const double *x) {
    Graphed *graph = &g->m.run->graph;
    const long long sides = graph->sides;
    const Machine one = view_at(g, graph->rest, sides, focus_of(g));
    Machine other;
    double here, there;
    change_side(g, k, x);
    other = view_at(g, graph->rest, graph->sides, focus_of(g));
    graph->sides = sides;
    here = number_at(&one, ZL_LIFT, x);
    there = number_at(&other, ZL_LIFT, x);
    if (fabs(here - there) > CONTINUOUS * fabs(here))
        return tell_two(&g->m, ZL_SPLITS, time, x, graph->focus, k);
    return GO_ON;
}

/* In place of the stops that were closed: a first state may be one of another run. */
#define FIRST_STATE (-1LL)

static int placed(Graph *g, double time, const double *state, long long was_closed, int by_switch,
                  int flying, const double *scaled);
static int strike(Graph *g, double time, const double *before, double approach);

/* Record the releases of stops that another event opens; 1 if the last of them ends the run. */
static int are_opened(Graph *g, long long stops, double time, const double *x) {
    zl_run *run = g->m.run;
    const double none[3] = {0.0, 0.0, 0.0};
    int k;
    for (k = 0; k < g->whole->graph->n_stops; k++)
        if (stops & BIT(k)) {
            double gap[2];
            write_event_of(&g->m, ZL_RELEASE, k, time, none, x, x);
            gap_of(g, k, x, gap);
            run->graph.met_gaps[k] = gap[0];
            run->n_releases++;
        }
    if (!stops || (double)run->n_releases < run->settings.most_releases) return 0;
    run->stage = OVER;
    return 1;
}

/* The switch that an event of a stop causes, or -1. */
static int setter_at(const Graph *g, int kind, int stop) {
    const zl_graph *graph = g->whole->graph;
    int k;
    for (k = 0; k < graph->n_declared; k++)
        if (graph->causes[k] == ZL_CAUSE(kind, stop)) return k;
    return -1;
}

/* Set states anew after an event of a stop, which may have ended the run. */
static int set_anew(Graph *g, int kind, int stop, double time, const double *state) {
    zl_run *run = g->m.run;
    const zl_graph *table = g->whole->graph;
    const int k = setter_at(g, kind, stop), is_over = run->stage == OVER;
    double x[ZL_MOST], after[ZL_MOST];
    int status;
    if (k < 0) return GO_ON;
    memcpy(x, state, (size_t)g->whole->n_x * sizeof(double));
    shared(g, &table->resets[k], table->reset_places[k], x, after);
    run->graph.flipped = 0;
    status = count_switch(g, time, k, x, after);
    if (status != GO_ON || is_over) return status;
    run->graph.has_current = 0;
    take_sides(g, after);
    return placed(g, time, after, closed_at_start(g), k, -1, 0);
}

/* Record a release, and those of the stops that open with it. */
static int release_all(Graph *g, double time, const double *x) {
    zl_run *run = g->m.run;
    const long long others = run->graph.together & ~BIT(focus_of(g));
    const int stop = focus_of(g), status = release(&g->m, time, x);
    double state[ZL_MOST];
    if (status != GO_ON) return status;
    if (run->stage != OVER && others) {
        memcpy(state, run->start.state, sizeof state);
        look(g, run->graph.rest & ~others, focus_of(g));
        are_opened(g, others, time, state);
    }
    return set_anew(g, ZL_RELEASE, stop, time, run->start.state);
}

/* Apply a switch whose guard fell through zero, within a flight with its scaled gap and rate, if it is
   one. */
static int switched(Graph *g, double time, const double *x, int k, const double *scaled) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    const zl_graph *table = g->whole->graph;
    const long long closed = closed_at_start(g);
    const int is_kink = k >= table->n_declared, was_above = is_above(g, k);
    const int is_free = run->start.mode == ZL_FREE;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS], armed[ZL_GUARDS], due[ZL_GUARDS];
    int status;
    if (!is_kink) {
        const int is_frictional = k >= table->n_declared - table->n_frictional;
        switches_due(g, x, formulas, levels, armed, due);
        if ((was_above && armed[k] > 0.0) || (is_frictional && due[k] > 0.0)) {
            double after[ZL_MOST];
            shared(g, &table->resets[k], table->reset_places[k], x, after);
            graph->flipped = 0;
            status = count_switch(g, time, k, x, after);
            if (status != GO_ON) return status;
            if (!is_frictional || !is_free) graph->has_current = 0;
            take_sides(g, after);
            status = settle(g, time, after);
            if (status != GO_ON) return status;
            return placed(g, time, after, closed, k, -1, 0);
        }
    }
    change_side(g, k, x);
    if (is_kink) {
        Other other;
        double pair[2];
        formulas_of_side(g, ZL_MODE_KEY(closed, graph->sides), k, !was_above, &other);
        if (g->asks) return GO_ON;
        tape_run(other.value, other.registers, x, pair);
        if (pair[1] < 0.0) return tell(&g->m, ZL_SLIDES, time, x, k);
        status = count_switch(g, time, k, x, x);
        if (status != GO_ON) return status;
        if (is_free && graph->has_current) {
            const long long n = run->pace.n_estimates;
            graph->split_present |= BIT(k);
            if ((graph->split_before & BIT(k)) && n &&
                speed_of(&g->m, n - 1) < ACCUMULATED * run->first_speed) {
                status = require_continuous(g, k, time, x);
                if (status != GO_ON) return status;
            }
        }
    }
    return placed(g, time, x, closed, -1, is_free ? focus_of(g) : -1, scaled);
}

/* Contact. */

/* Whether a stop at zero gap and rate stays closed. */
static int holds(const Machine *m, const double *x) {
    return mode_on_stop(m, x) == ZL_LOCKED;
}

/* The stops that stay closed, of those with zero gap and gap rate, of which some set must fulfil the
   laws of contact, and no other. */
static int contact_set(Graph *g, double time, const double *x, long long still, long long *found) {
    const int n = (int)g->whole->graph->n_stops;
    long long closed = still;
    int count = 0, k;
    *found = 0;
    /* All subsets, down to the empty one. */
    for (;;) {
        int fits = 1;
        for (k = 0; fits && k < n; k++)
            if (closed & BIT(k)) {
                const Machine m = holding(g, closed, k);
                fits = holds(&m, x);
            } else if (still & BIT(k)) {
                const Machine m = view_at(g, closed, g->m.run->graph.sides, k);
                fits = !holds(&m, x);
            }
        if (fits) {
            count++;
            *found = closed;
        }
        if (!closed) break;
        closed = (closed - 1) & still;
    }
    if (count == 1 || g->asks) return GO_ON;
    g->m.run->detail.about[0] = still;
    return tell(&g->m, ZL_UNDETERMINED, time, x, 0);
}

/* The impulses of closed stops in an impact, by Gauss's method: the matrix is positive definite. */
static void shares_of(const double *all, int n_stops, const int *kept, int n, int focus,
                      double *shares) {
    double rows[ZL_STOPS][ZL_STOPS + 1];
    int i, j, k;
    for (i = 0; i < n; i++) {
        for (j = 0; j < n; j++) rows[i][j] = all[kept[i] * n_stops + kept[j]];
        rows[i][n] = all[kept[i] * n_stops + focus];
    }
    for (k = 0; k < n; k++)
        for (i = k + 1; i < n; i++) {
            const double factor = rows[i][k] / rows[k][k];
            for (j = k; j <= n; j++) rows[i][j] -= factor * rows[k][j];
        }
    for (i = n - 1; i >= 0; i--) {
        for (j = i + 1; j < n; j++) rows[i][n] -= rows[i][j] * shares[j];
        shares[i] = rows[i][n] / rows[i][i];
    }
}

/* Whether a set of closed stops fulfils the laws of an impact: none pulls, and no other closes. */
static int fits_impact(const double *all, int n_stops, long long rest, long long closed, int focus,
                       double small) {
    double shares[ZL_STOPS];
    int kept[ZL_STOPS], n = 0, i, k;
    for (k = 0; k < n_stops; k++)
        if (closed & BIT(k)) kept[n++] = k;
    shares_of(all, n_stops, kept, n, focus, shares);
    for (i = 0; i < n; i++)
        if (shares[i] > small / greater(fabs(all[kept[i] * n_stops + kept[i]]), small)) return 0;
    for (k = 0; k < n_stops; k++)
        if ((rest & ~closed) & BIT(k)) {
            double rate = all[k * n_stops + focus], pushed = 0.0;
            for (i = 0; i < n; i++) pushed += all[k * n_stops + kept[i]] * shares[i];
            if (!(rate - pushed >= -small)) return 0;
        }
    return 1;
}

static int count_of(long long set) {
    int n = 0;
    for (; set; set &= set - 1) n++;
    return n;
}

/* The closed stops that stay closed in an impact: none of them pulls, theory (1.15). */
static long long kept_closed(Graph *g, const double *x) {
    const zl_graph *graph = g->whole->graph;
    const int n_stops = (int)graph->n_stops;
    const long long rest = g->m.run->graph.rest;
    double all[ZL_STOPS * ZL_STOPS], small = 0.0;
    int k, n;
    if (!rest) return 0;
    shared(g, &graph->delassus, graph->delassus_place, x, all);
    for (k = 0; k < n_stops * n_stops; k++) small = greater(small, fabs(all[k]));
    small *= LEAST_IMPULSE;
    for (n = count_of(rest); n >= 0; n--) {
        long long closed = rest;
        for (;;) {
            if (count_of(closed) == n && fits_impact(all, n_stops, rest, closed, focus_of(g), small))
                return closed;
            if (!closed) break;
            closed = (closed - 1) & rest;
        }
    }
    return 0;
}

/* Whether a stop has zero gap and gap rate to the accuracy of a flight. */
static int rests(Graph *g, int stop, const double *x) {
    const zl_settings *settings = settings_of(g, stop);
    double gap[2];
    gap_of(g, stop, x, gap);
    return gap[0] <= LOW * settings->gap && fabs(gap[1]) <= SLOW * settings->gap_rate;
}

/* The same of the stops of the last impacts. */
static int they_rest(Graph *g, const double *x) {
    const Graphed *graph = &g->m.run->graph;
    long long k;
    for (k = 0; k < graph->n_turn; k++)
        if (!rests(g, (int)graph->turn_stops[k], x)) return 0;
    return 1;
}

/* Whether two stops of the last impacts are coupled. Others come to rest each by itself. */
static int turns_are_tied(Graph *g, double time, const double *x) {
    const Graphed *graph = &g->m.run->graph;
    long long k, struck = 0;
    for (k = 0; k < graph->n_turn; k++) struck |= BIT(graph->turn_stops[k]);
    return require_apart(g, struck, graph->rest, time, x) != GO_ON;
}

/* Strike a stop that closes at the time of an impact on another stop, if there is one. */
static int strike_again(Graph *g, double time) {
    zl_run *run = g->m.run;
    const long long closed = closed_at_start(g);
    double x[ZL_MOST], gap[2];
    int k, status;
    if (g->asks) return GO_ON;
    memcpy(x, run->start.state, sizeof x);
    for (k = 0; k < g->whole->graph->n_stops; k++) {
        const zl_settings *settings = settings_of(g, k);
        if ((closed | BIT(run->graph.focus)) & BIT(k)) continue;
        gap_of(g, k, x, gap);
        if (!(gap[1] < -settings->contact * settings->gap_rate &&
              closes(g, k, gap, x, settings->contact * settings->gap)))
            continue;
        status = require_apart(g, BIT(run->graph.focus) | BIT(k), closed, time, x);
        if (status != GO_ON) return status;
        if (!closes_now(g, k, gap, x)) continue;
        look(g, closed, k);
        return strike(g, time, x, gap[1]);
    }
    return GO_ON;
}

/* Whether impacts on stops accumulate at some gap accelerations. */
static int accumulate(Graph *g, long long stops, const double *lifts) {
    int k, fits = 1;
    for (k = 0; k < g->whole->graph->n_stops; k++)
        if ((stops & BIT(k)) && !(lifts[k] < 0.0 && settings_of(g, k)->restitution < 1.0)) fits = 0;
    return fits;
}

/* The time to the Zeno point of each stop at a constant gap acceleration, the speeds of its next
   impact and after it, and the error of the time by the rounding of the gap. The stop that the run
   looks at is struck now. The longest time is returned. */
static double ways_to_rest(Graph *g, long long stops, const double *lifts, const double *x,
                           double approach, double *ways, double *hits, double *speeds,
                           double *doubts) {
    double longest = 0.0;
    int k;
    for (k = 0; k < g->whole->graph->n_stops; k++) {
        const double e = settings_of(g, k)->restitution;
        double pair[2], speed, excess = 0.0, rounding = 0.0;
        if (!(stops & BIT(k))) continue;
        gap_of(g, k, x, pair);
        pair[0] = greater(pair[0] - g->m.run->graph.met_gaps[k], 0.0);
        if (k != focus_of(g)) rounding = rounding_of_states(g, k, x);
        if (k == focus_of(g)) {
            pair[0] = 0.0;
            pair[1] = approach;
        }
        speed = sqrt(pair[1] * pair[1] - 2.0 * lifts[k] * pair[0]);
        hits[k] = speed;
        speeds[k] = e * speed;
        if (settings_of(g, k)->varies) {
            const Machine m = view_at(g, g->m.run->graph.rest, g->m.run->graph.sides, k);
            speeds[k] = rebound(&m, speed);
            excess = speeds_excess(&m, speeds[k]);
        }
        ways[k] = (pair[1] + speed) / -lifts[k] + 2.0 * speeds[k] / (-lifts[k] * (1.0 - e)) +
                  2.0 * excess / -lifts[k];
        doubts[k] = 0.0;
        if (rounding != 0.0)
            doubts[k] = rounding * (1.0 + e) /
                        ((1.0 - e) * greater(speed, sqrt(-2.0 * lifts[k] * rounding)));
        longest = greater(longest, ways[k]);
    }
    return longest;
}

/* The state after a short time on closed stops, by the midpoint rule. */
static void held_for(Graph *g, long long closed, const double *x, double time, double *after) {
    const long long n_x = g->whole->n_x;
    double rate[ZL_MOST], middle[ZL_MOST];
    long long i;
    flow_at(g, closed, x, rate);
    for (i = 0; i < n_x; i++) middle[i] = x[i] + time / 2.0 * rate[i];
    flow_at(g, closed, middle, rate);
    for (i = 0; i < n_x; i++) after[i] = x[i] + time * rate[i];
}

/* By how much the gap acceleration of each stop may change while stops bounce:
   `ReferenceRun._changes_of_lift`. */
static void changes_of_lift(Graph *g, long long stops, long long closed, const double *rested,
                            const double *lifts, const double *hits, double *changes) {
    const int n = (int)g->whole->graph->n_stops;
    const long long n_x = g->whole->n_x;
    double still[ZL_MOST], rate[ZL_MOST], given[ZL_MOST + 1], landed[3 * ZL_MOST + 2];
    double states[2][ZL_MOST], at_rest[ZL_STOPS] = {0.0};
    long long i;
    int j, k, side, late;
    flow_at(g, closed, rested, still);
    for (k = 0; k < n; k++) {
        changes[k] = 0.0;
        if (stops & BIT(k)) {
            const Machine m = view_at(g, g->m.run->graph.rest, g->m.run->graph.sides, k);
            at_rest[k] = number_at(&m, ZL_LIFT, rested);
        }
    }
    for (j = 0; j < n; j++) {
        double most[ZL_STOPS] = {0.0};
        if (!(stops & BIT(j))) continue;
        {
            const Machine m = view_at(g, g->m.run->graph.rest, g->m.run->graph.sides, j);
            memcpy(given, rested, (size_t)n_x * sizeof(double));
            given[n_x] = -hits[j];
            evaluate_at(&m, ZL_LANDING, given, landed);
        }
        for (side = 1; side >= -1; side -= 2) {
            for (i = 0; i < n_x; i++) states[0][i] = rested[i] + side * (landed[i] - rested[i]);
            flow_at(g, closed, states[0], rate);
            for (i = 0; i < n_x; i++)
                states[1][i] = states[0][i] + 2.0 * hits[j] / -lifts[j] * (rate[i] - still[i]);
            for (k = 0; k < n; k++) {
                Machine m;
                if (!(stops & BIT(k))) continue;
                m = view_at(g, g->m.run->graph.rest, g->m.run->graph.sides, k);
                for (late = 0; late < 2; late++)
                    most[k] = greater(most[k],
                                      fabs(number_at(&m, ZL_LIFT, states[late]) - at_rest[k]));
            }
        }
        for (k = 0; k < n; k++) changes[k] += most[k];
    }
}

/* Whether no guard beside closed stops has fallen at a state, and no kink jumps. */
static int clear_beside(Graph *g, long long closed, const double *x) {
    const zl_graph *table = g->whole->graph;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS], pair[2];
    int k;
    for (k = 0; k < table->n_stops; k++) {
        if (closed & BIT(k)) continue;
        gap_of(g, k, x, pair);
        if (!(pair[0] > 0.0)) return 0;
    }
    switches_at(g, x, formulas, levels, 0);
    for (k = 0; k < table->n_switches; k++) {
        const double small = SPENT * levels[k];
        if (!((is_above(g, k) ? formulas[k] : -formulas[k]) > -small)) return 0;
        if (fabs(formulas[k]) <= small &&
            (k < table->n_declared || !leave_flow(g, BIT(k), closed, x)))
            return 0;
    }
    return 1;
}

/* Go to the Zeno points of several stops at rest, one of which is struck: `ReferenceRun._limit_of_each`.
   They are not coupled, and their gap accelerations are constant but for a linear change. */
static int limit_of_each(Graph *g, double time, const double *before, double approach, int *done) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    const zl_graph *table = g->whole->graph;
    const int n = (int)table->n_stops;
    const size_t bytes = (size_t)g->whole->n_x * sizeof(double);
    double lifts[ZL_STOPS] = {0.0}, means[ZL_STOPS] = {0.0}, rough[ZL_STOPS] = {0.0};
    double ways[ZL_STOPS] = {0.0}, speeds[ZL_STOPS] = {0.0}, doubts[ZL_STOPS] = {0.0};
    double hits[ZL_STOPS] = {0.0}, changes[ZL_STOPS] = {0.0};
    double rested[ZL_MOST], longest;
    long long stops = 0, closed, found, left;
    Limit limit;
    int k, status;
    *done = 0;
    if (!(-SLOW * run->settings.gap_rate <= approach && approach < 0.0)) return GO_ON;
    for (k = 0; k < n; k++)
        if (!((graph->rest | BIT(graph->focus)) & BIT(k)) && rests(g, k, before)) stops |= BIT(k);
    if (!stops) return GO_ON;
    stops |= BIT(graph->focus);
    for (k = 0; k < n; k++)
        if ((stops & BIT(k)) && (setter_at(g, ZL_ZENO, k) >= 0 || setter_at(g, ZL_IMPACT, k) >= 0))
            return GO_ON;
    closed = stops | graph->rest;
    if (require_apart(g, stops, graph->rest, time, before) != GO_ON) return GO_ON;
    memcpy(rested, before, bytes);
    for (k = 0; k < n; k++)
        if (closed & BIT(k)) {
            const Machine m = holding(g, closed, k);
            to_stop(&m, rested, rested);
        }
    for (k = 0; k < n; k++)
        if (stops & BIT(k)) {
            const Machine m = view_at(g, graph->rest, graph->sides, k);
            lifts[k] = number_at(&m, ZL_LIFT, rested);
        }
    if (!accumulate(g, stops, lifts)) return GO_ON;
    longest = ways_to_rest(g, stops, lifts, before, approach, rough, hits, speeds, doubts);
    held_for(g, closed, rested, longest, limit.state);
    for (k = 0; k < n; k++)
        if (stops & BIT(k)) {
            const Machine m = view_at(g, graph->rest, graph->sides, k);
            means[k] = (lifts[k] + number_at(&m, ZL_LIFT, limit.state)) / 2;
        }
    if (!accumulate(g, stops, means)) return GO_ON;
    longest = ways_to_rest(g, stops, means, before, approach, ways, hits, speeds, doubts);
    held_for(g, closed, rested, longest, limit.state);
    limit.time = time + longest;
    limit.error = 0.0;
    changes_of_lift(g, stops, closed, rested, means, hits, changes);
    for (k = 0; k < n; k++)
        if (stops & BIT(k)) {
            const double share = changes[k] / (1.0 - settings_of(g, k)->restitution);
            const double doubt = greater(fabs(ways[k] - rough[k]), ways[k] * share / -means[k]);
            limit.error = greater(limit.error, doubt / (run->settings.time + limit.time));
        }
    if (!(limit.error <= SPLIT && limit.time < run->settings.until &&
          clear_beside(g, closed, limit.state)))
        return GO_ON;
    status = contact_set(g, limit.time, limit.state, closed, &found);
    if (status != GO_ON) return status;
    if (found != closed) return GO_ON;
    status = may_reach(&g->m, &limit);
    if (status != GO_ON) return status;
    *done = 1;
    for (k = 0; k < n; k++)
        if (stops & BIT(k))
            limit.error = greater(limit.error, doubts[k] / (run->settings.time + limit.time));
    for (left = stops; left;) {
        int first = -1;
        double state[ZL_MOST], told[3];
        for (k = 0; k < n; k++)
            if ((left & BIT(k)) && (first < 0 || ways[k] < ways[first])) first = k;
        left &= ~BIT(first);
        told[0] = limit.error;
        told[1] = ways[first];
        told[2] = speeds[first];
        held_for(g, closed, rested, ways[first], state);
        write_event_of(&g->m, ZL_ZENO, first, time + ways[first], told, state, state);
    }
    {
        const double numbers[ZL_ARC_WIDTH] = {
            ZL_FREE, time, limit.time, 1.0, longest, ZL_ZENO, (double)run->n_impacts,
            (double)run->n_rows, 0.0, (double)run->n_polynomials, 0.0, 0.0, 0.0,
            (double)graph->view};
        write_arc(&g->m, numbers, rested, limit.state, g->whole->n_x);
    }
    for (k = 0, left = 0; k < graph->n_turn; k++)
        if (!(stops & BIT(graph->turn_stops[k]))) {
            graph->turn_times[left] = graph->turn_times[k];
            graph->turn_stops[left++] = graph->turn_stops[k];
        }
    graph->n_turn = left;
    graph->has_current = 0;
    for (k = n - 1; !(closed & BIT(k));) k--;
    look(g, closed & ~BIT(k), k);
    start_without_speed(run, ZL_LOCKED, limit.time);
    memcpy(run->start.state, limit.state, bytes);
    return GO_ON;
}

/* Apply the reset map in the mode that its impulses determine. */
static int strike(Graph *g, double time, const double *before, double approach) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    zl_start *start = &run->start;
    const long long was = graph->rest, n_x = g->whole->n_x, focus = BIT(graph->focus);
    long long closed, candidates, held = focus;
    double given[ZL_MOST + 1], landed[3 * ZL_MOST + 2];
    const int stop = focus_of(g);
    int status, done, comes_in_turn, reached, is_set, k;
    comes_in_turn = see_impact(&g->m, time) && they_rest(g, before);
    status = limit_of_each(g, time, before, approach, &done);
    if (status != GO_ON || done) return status;
    if (comes_in_turn && turns_are_tied(g, time, before)) return in_turn(&g->m, time, before);
    graph->split_before = graph->split_present;
    graph->split_present = 0;
    /* What an impact causes belongs to the sequence of the impacts. */
    for (k = 0; k < g->whole->graph->n_switches; k++)
        if (frictional(g) & BIT(k)) graph->n_row[k] = 0;
    if (approach < 0.0) {
        look(g, kept_closed(g, before), focus_of(g));
        memcpy(given, before, (size_t)n_x * sizeof(double));
        given[n_x] = approach;
        evaluate_at(&g->m, ZL_LANDING, given, landed);
        take_sides(g, landed);
        look(g, graph->rest, focus_of(g));
    }
    status = impact(&g->m, time, before, approach);
    if (status != GO_ON) return status;
    if (run->stage == OVER) {
        const zl_records *records = g->m.records;
        const double *last = records->events + records->n_events * (ZL_EVENT_WIDTH + 2 * n_x) - n_x;
        return set_anew(g, ZL_IMPACT, stop, time, last);
    }
    reached = start->mode == ZL_LOCKED;
    is_set = setter_at(g, ZL_IMPACT, stop) >= 0 || (reached && setter_at(g, ZL_ZENO, stop) >= 0);
    /* The stop opens at once, or its only impact was a Zeno point. */
    if (!start->has_speed) graph->has_current = 0;
    candidates = closed = closed_at_start(g);
    if (graph->rest) {
        status = contact_set(g, time, start->state, candidates, &closed);
        if (status != GO_ON) return status;
        held = (graph->rest | focus) & closed;
    }
    if (are_opened(g, was & ~held, time, start->state)) return GO_ON;
    if (closed != candidates) {
        graph->has_current = 0;
        look(g, closed & ~focus, focus_of(g));
        if (start->mode == ZL_LOCKED && !(closed & focus)) {
            start->mode = ZL_FREE;
        } else if (start->has_impact) {
            double told[2 * ZL_MOST + 1];
            evaluate_at(&g->m, ZL_RESTING, start->plus, told);
            memcpy(start->resting, told, (size_t)n_x * sizeof(double));
            start->lift = told[n_x];
            memcpy(start->rate, told + n_x + 1, (size_t)n_x * sizeof(double));
        }
    }
    if (!is_set) return strike_again(g, time);
    status = set_anew(g, ZL_IMPACT, stop, time, start->state);
    if (status != GO_ON || !reached || g->asks) return status;
    return set_anew(g, ZL_ZENO, stop, time, start->state);
}

/* Apply the impact at the end of a flight, or fly on from a graze. */
static int land_at(Graph *g, double time, const double *x, double rate) {
    if (rate > 0.0) return landing(&g->m, time, x, rate);
    return strike(g, time, x, rate);
}

/* See what follows where the gap of the stop closes: it is struck, or only touched. */
static int meet_at(Graph *g, double time, const double *x, double rate) {
    if (!(fabs(rate) <= g->m.run->small_rate)) return land_at(g, time, x, rate);
    start_on_stop(&g->m, time, x);
    if (g->m.run->start.mode == ZL_FREE) g->m.run->graph.has_current = 0;
    return GO_ON;
}

/* Whether a flight begins on its stop now, and is not under way. A gap above its rounding belongs to
   the flight, unless an event has just closed it. */
static int is_left(Graph *g, const double *x, const double *gap, long long was_closed, int flying) {
    const zl_run *run = g->m.run;
    const int stop = focus_of(g), is_first = was_closed == FIRST_STATE;
    if (!(gap[0] <= run->small_gap && gap[1] > run->small_rate)) return 0;
    if ((!is_first && was_closed & BIT(stop)) || is_met(run, stop)) return 1;
    if (is_first && gap[0] <= gap[1] * APART * run->settings.time) return 1;
    return stop != flying && gap[0] <= rounding_of_gap(g, stop, x);
}

/* The start at a state: each stop with zero gap and rate holds, or opens. A flight goes on with its
   scaled gap and rate, if they are given. */
static int placed(Graph *g, double time, const double *state, long long was_closed, int by_switch,
                  int flying, const double *scaled) {
    zl_run *run = g->m.run;
    const zl_graph *table = g->whole->graph;
    const size_t bytes = (size_t)g->whole->n_x * sizeof(double);
    long long still = 0, opening = 0, struck = 0, closed, leaving;
    const int is_first = was_closed == FIRST_STATE;
    const double unit = run->start.speed;
    double x[ZL_MOST], gap[2];
    int k, n = (int)table->n_stops, focus, status;
    memcpy(x, state, bytes);
    for (k = 0; k < n; k++) {
        const zl_settings *settings = settings_of(g, k);
        const double contact = settings->contact;
        const double below = was_closed & BIT(k) ? greater(START_OFF, contact) : contact;
        /* Of one stop alone, a start is as exact as its user gives it. */
        const double small = has_others(&g->m) ? below : contact;
        /* An open gap of a first state is as exact as its user gives it. */
        const double apart = is_first ? contact : small;
        const int is_given = is_first || (was_closed & BIT(k));
        int is_on, falls;
        if (scaled && k == flying) continue;
        gap_of(g, k, x, gap);
        is_on = gap[0] >= -below * settings->gap;
        falls = gap[1] < -small * settings->gap_rate;
        if (gap[0] > apart * settings->gap || (k == flying && !(is_on && falls))) continue;
        /* A gap above its rounding belongs to a flight, unless the stop was closed. */
        if (!is_given && gap[0] > rounding_of_gap(g, k, x) && !is_zero(g, gap, 0.0)) continue;
        if (is_on && fabs(gap[1]) <= small * settings->gap_rate)
            still |= BIT(k);
        else if (is_on && gap[1] > 0.0)
            opening |= BIT(k);
        else if (by_switch >= 0 && !is_on)
            return tell_two(&g->m, ZL_BY_SWITCH, time, x, by_switch, k);
        else
            struck |= BIT(k);
    }
    status = contact_set(g, time, x, still, &closed);
    if (status != GO_ON) return status;
    for (k = 0; k < n; k++)
        if (closed & BIT(k)) {
            const Machine m = holding(g, closed, k);
            double on_stop[ZL_MOST];
            to_stop(&m, x, on_stop);
            memcpy(x, on_stop, bytes);
        }
    status = require_apart(g, struck, closed, time, x);
    if (status != GO_ON) return status;
    for (k = 0; k < n; k++)
        if ((struck & BIT(k)) && settings_of(g, k)->restitution == 0.0) was_closed &= ~BIT(k);
    if (!is_first && are_opened(g, was_closed & ~closed, time, x)) return GO_ON;
    if (struck) {
        int first = 0;
        while (!(struck & BIT(first))) first++;
        look(g, closed, first);
        evaluate_at(&g->m, ZL_GAP, x, gap);
        return strike(g, time, x, gap[1]);
    }
    /* Of those that open, one at rest comes first. */
    leaving = still & ~closed ? still & ~closed : opening & ~closed;
    if (!leaving && flying >= 0) leaving = BIT(flying);
    if (closed && !leaving) {
        for (focus = n - 1; !(closed & BIT(focus));) focus--;
        look(g, closed & ~BIT(focus), focus);
        start_without_speed(run, ZL_LOCKED, time);
        memcpy(run->start.state, x, bytes);
        return GO_ON;
    }
    focus = focus_of(g);
    if (leaving)
        for (focus = 0; !(leaving & BIT(focus));) focus++;
    look(g, closed, focus);
    evaluate_at(&g->m, ZL_GAP, x, gap);
    start_without_speed(run, ZL_FREE, time);
    memcpy(run->start.state, x, bytes);
    if (scaled && focus == flying) {
        run->start.speed = unit;
        run->start.height = scaled[0];
        run->start.launch = scaled[1];
        run->start.has_speed = 1;
    } else if (is_left(g, x, gap, was_closed, flying)) {
        run->start.speed = gap[1];
        run->start.has_speed = 1;
    }
    return GO_ON;
}

/* What follows the event of another guard. `rate` is the gap rate, if it is known better than by the
   state. */
static int after_other(Graph *g, double time, const double *x, const Other *other,
                       const double *rate, const double *scaled) {
    zl_run *run = g->m.run;
    const long long closed = closed_at_start(g);
    double gap[2];
    run->stage = AT_START;
    if (other->kind == ZL_SWITCH) return switched(g, time, x, other->index, scaled);
    run->graph.has_current = 0;
    if (other->kind == ZL_RELEASE) {
        look(g, closed & ~BIT(other->index), other->index);
        return release_all(g, time, x);
    }
    look(g, closed, other->index);
    evaluate_at(&g->m, ZL_GAP, x, gap);
    return meet_at(g, time, x, rate ? *rate : gap[1]);
}

/* Sequences of impacts. */

/* Whether no other guard falls on the way to a Zeno point: a status if that is refused. */
static int is_clear_at(Graph *g, const Limit *limit, int *clear) {
    const zl_graph *table = g->whole->graph;
    const Graphed *graph = &g->m.run->graph;
    const double *x = limit->state;
    double formulas[ZL_GUARDS], levels[ZL_GUARDS], pair[2];
    long long zero = graph->split_before;
    int k;
    *clear = 0;
    for (k = 0; k < table->n_stops; k++)
        if (!((graph->rest | BIT(graph->focus)) & BIT(k))) {
            gap_of(g, k, x, pair);
            if (!(pair[0] > 0.0)) return GO_ON;
        }
    for (k = 0; k < table->n_stops; k++)
        if (graph->rest & BIT(k)) {
            const Machine m = holding(g, graph->rest, k);
            evaluate_at(&m, ZL_GUARD + ZL_LOCKED, x, pair);
            if (!(pair[0] > 0.0)) return GO_ON;
        }
    switches_at(g, x, formulas, levels, 0);
    for (k = (int)(table->n_declared - table->n_frictional); k < table->n_declared; k += PER_PART)
        if (graph->split_before & (BIT(PER_PART) - 1) << k) zero |= (BIT(PER_PART) - 1) << k;
    for (k = 0; k < table->n_switches; k++)
        /* A kink or a part that splits every flight is zero at the limit itself. */
        if (!(zero & BIT(k)) &&
            !((is_above(g, k) ? formulas[k] : -formulas[k]) > -SPENT * levels[k]))
            return GO_ON;
    for (k = (int)table->n_declared; k < table->n_switches; k++)
        if ((graph->split_before & BIT(k)) && fabs(formulas[k]) <= SPENT * levels[k]) {
            int status = require_continuous(g, k, limit->time, x);
            if (status != GO_ON) return status;
        }
    *clear = 1;
    return GO_ON;
}

/* Take its rate from every part that sticks in every flight, at the limit of the impacts. */
static void stop_parts(Graph *g, long long beside, double *x) {
    const zl_graph *table = g->whole->graph;
    int k;
    for (k = (int)(table->n_declared - table->n_frictional); k < table->n_declared; k += PER_PART)
        if (beside & BIT(k)) {
            double after[ZL_MOST];
            shared(g, &table->resets[k], table->reset_places[k], x, after);
            memcpy(x, after, (size_t)g->whole->n_x * sizeof(double));
        }
}

/* Follow one flight of a sequence of impacts, or go to its Zeno point. A switch of dry friction may be
   due at its start, else -1. */
static int fly_on(Graph *g, int due) {
    zl_run *run = g->m.run;
    Graphed *graph = &run->graph;
    zl_start *start = &run->start;
    Limit limit;
    int found = NO_LIMIT, is_due = 0, is_clear, is_slow, status;
    long long beside;
    if (!graph->has_current || graph->current_rest != graph->rest ||
        graph->current_focus != graph->focus) {
        graph->has_current = 1;
        graph->current_rest = graph->rest;
        graph->current_focus = graph->focus;
        graph->split_before = graph->split_present = 0;
        run->pace.first_impact = run->n_impacts;
        run->pace.n_estimates = 0;
    }
    beside = graph->split_before & frictional(g);
    is_slow = beside && start->speed <= SLOW_BESIDE * run->settings.gap_rate;
    if (run->stage == AT_CURVE) {
        is_due = 1;
        if (run->answered) {
            limit.time = run->answer_time;
            limit.error = run->answer_error;
            memcpy(limit.state, run->answer, sizeof limit.state);
            found = LIMIT;
        }
    } else if (start->has_impact) {
        if (run->pace.n_estimates == g->m.records->most_estimates) return ZL_ESTIMATES;
        if (run->pace.n_estimates && start->speed >= speed_of(&g->m, run->pace.n_estimates - 1))
            run->pace.n_estimates = 0;
        if (!add_estimate(&g->m, beside))
            run->pace.n_estimates = 0;
        else if (due < 0 || beside) {
            is_due = 1;
            found = limit_by_rule(&g->m, &limit);
        }
    }
    /* Along the curve of the impacts, no kink changes its side within a flight. */
    if (found == CURVE && graph->split_before) found = NO_LIMIT;
    if (found == CURVE) {
        run->stage = AT_CURVE;
        run->answered = 0;
        return ZL_CURVE;
    }
    /* Flights that a kink splits determine the Zeno point less accurately. */
    if (is_due && found == NO_LIMIT && graph->split_before &&
        extrapolated(&g->m, is_slow ? 1.0 : SPLIT_RESOLVED, SPLIT, &limit))
        found = LIMIT;
    if (is_due && found == NO_LIMIT && beside &&
        start->speed <= LEAST_BESIDE * run->settings.gap_rate) {
        int k = 0;
        while (!(beside & BIT(k))) k++;
        return tell(&g->m, ZL_ACCUMULATE, start->time, start->resting, k);
    }
    if (found == LIMIT) stop_parts(g, beside, limit.state);
    if (found == LIMIT && limit.time < run->settings.until) {
        status = is_clear_at(g, &limit, &is_clear);
        if (status != GO_ON || g->asks) return status;
        if (is_clear && mode_on_stop(&g->m, limit.state) == ZL_LOCKED) {
            status = may_reach(&g->m, &limit);
            if (status != GO_ON) return status;
            reach(&g->m, &limit, start->time, start->speed);
            graph->has_current = 0;
            start_without_speed(run, ZL_LOCKED, limit.time);
            memcpy(start->state, limit.state, (size_t)g->whole->n_x * sizeof(double));
            return set_anew(g, ZL_ZENO, focus_of(g), limit.time, start->state);
        }
        if (is_clear) graph->has_current = 0;
    }
    if (due >= 0) return switched_at_start(g, due);
    if (run->n_impacts - run->pace.first_impact > run->settings.most_impacts)
        return tell(&g->m, ZL_MANY_IMPACTS, start->time, start->state, 0);
    return begin_arc(g, FLIGHT_ARC);
}

/* Whether the switching times of all piecewise inputs are apart. */
static int are_in_order(const Graph *g) {
    const zl_graph *graph = g->whole->graph;
    const long long n = graph->orders.n_outputs / 3;
    double times[3 * ZL_ORDERS], none = 0.0;
    long long k;
    if (!n) return 1;
    shared(g, &graph->orders, graph->orders_place, &none, times);
    for (k = 0; k < n; k++)
        if (!(times[n + k] > times[2 * n + k])) return 0;
    return 1;
}

/* The first start, from an admissible state. */
static int admit_to_graph(Graph *g) {
    zl_run *run = g->m.run;
    const zl_graph *table = g->whole->graph;
    double x[ZL_MOST], gap[2];
    int k;
    memcpy(x, run->start.state, sizeof x);
    if (!are_in_order(g)) return tell(&g->m, ZL_UNORDERED, 0.0, x, 0);
    run->graph.sides = BIT(table->n_switches - table->n_declared) - 1;
    run->graph.above = run->graph.rest = run->graph.focus = 0;
    run->graph.flipped = 0;
    run->graph.flipped_time = NAN;
    run->graph.has_events = 0;
    for (k = 0; k < ZL_STOPS; k++) {
        run->graph.met_times[k] = NAN;
        run->graph.met_gaps[k] = 0.0;
    }
    take_sides(g, x);
    look(g, 0, 0);
    start_without_speed(run, ZL_FREE, 0.0);
    for (k = 0; k < table->n_stops; k++) {
        const zl_settings *settings = settings_of(g, k);
        gap_of(g, k, x, gap);
        if (gap[0] < -greater(START_OFF, settings->contact) * settings->gap) {
            run->detail.number = gap[0];
            return tell(&g->m, ZL_INSIDE, 0.0, x, k);
        }
    }
    return placed(g, 0.0, x, FIRST_STATE, -1, -1, 0);
}

/* Begin an arc without an impact at its start. A flight that a plastic impact throws up, and that the
   stop's own force throws back at once, is a hop. */
static int begin_from_rest(Graph *g) {
    zl_run *run = g->m.run;
    const zl_settings *settings = &run->settings;
    const double *x = run->start.state;
    if (run->start.mode == ZL_LOCKED) return begin_arc(g, LOCKED_ARC);
    if (g->whole->graph->n_stops &&
        number_at(&g->m, ZL_LIFT, x) > settings->contact * settings->gap_acceleration &&
        number_at(&g->m, ZL_PULL, x) > 0.0) {
        run->graph.hop = small_hop(&g->m);
        run->graph.hop.comes_first = 1;
        if (run->graph.hop.duration != 0.0) return begin_arc(g, HOP_ARC);
    }
    return begin_arc(g, FREE_ARC);
}

/* Do the next thing: a step, an event, the start of an arc. */
static int do_next_in_graph(Graph *g) {
    zl_run *run = g->m.run;
    int outcome, due;
    switch (run->stage) {
    case BEFORE:
        return admit_to_graph(g);
    case AT_START:
        outcome = find_due(g, &due);
        if (outcome != GO_ON) return outcome;
        if (due >= 0 && (run->start.mode == ZL_LOCKED || !run->start.has_speed))
            return switched_at_start(g, due);
        if (run->start.has_speed) return fly_on(g, due);
        return begin_from_rest(g);
    case AT_CURVE:
        if (run->start.has_speed) return fly_on(g, -1);
        return begin_from_rest(g);
    case LAUNCHES:
        return launch(g);
    case IN_LEG:
        outcome = step_leg(&g->m);
        if (outcome == LEG_GOES_ON) return GO_ON;
        run->graph.outcome = outcome;
        run->stage = ENDED;
        return GO_ON;
    case IN_SIDE:
        return step_aside(g);
    case ENDED:
        return arc_ended(g);
    case DECIDES:
        return decide(g);
    default:
        return ZL_DONE;
    }
}

/* Whether no view and no side can be missing. */
static int is_whole(const zl_graph *graph) {
    const long long n_kinks = graph->n_switches - graph->n_declared;
    return graph->n_views == graph->n_stops << (graph->n_stops - 1 + n_kinks) &&
           graph->n_sides == 2 * graph->n_switches << (graph->n_stops + n_kinks);
}

/* The same. Where a view or side is missing, the run stands where it was, and asks for it. */
static int advance_in_graph(Graph *g) {
    zl_run *run = g->m.run;
    const long long stage = run->stage;
    const int may_ask = stage != IN_LEG && stage != IN_SIDE && !is_whole(g->whole->graph);
    double before[offsetof(zl_run, settings) / sizeof(double)];
    const zl_records records = *g->m.records;
    int status;
    if (may_ask) memcpy(before, run, sizeof before);
    status = do_next_in_graph(g);
    if (g->asks && may_ask) {
        memcpy((void *)run, before, sizeof before);
        *g->m.records = records;
        /* What was done after the question, without its formulas, may have told something else. */
        memcpy(run->detail.about, g->asked, sizeof g->asked);
        return ZL_MODE;
    }
    if (status == ZL_LEFT && (stage == ENDED || stage == DECIDES || stage == IN_SIDE))
        status = leave_arc(g);
    if (stage != BEFORE && (status == ZL_LEFT || status == ZL_BY_SWITCH || status == ZL_INTO_STOP))
        status = penetrates(g, status);
    return status;
}

/* A run over a graph as its memory has it. */
static void enter_graph(Graph *g, const zl_problem *problem, zl_run *run, zl_records *records) {
    g->m = machine_of(problem, run, records);
    g->whole = problem;
    g->asks = 0;
    if (run->stage == BEFORE) return;
    adopt(g, run->graph.view);
    if (run->stage == IN_LEG || run->stage >= ENDED) find_others(g);
}

/* Begin a run: the settings of every stop, and parameters. */
static void begin_in_graph(const zl_problem *problem, zl_run *run, const zl_settings *settings,
                           const double *p) {
    const zl_graph *graph = problem->graph;
    double *numbers;
    long long k;
    memcpy(settings_at(run), settings, (size_t)graph->n_stops * sizeof *settings);
    memcpy(parameters_at(graph, run), p, (size_t)problem->n_p * sizeof(double));
    numbers = numbers_at(problem, run);
    for (k = 0; k < graph->n_views; k++)
        ((Ready *)(void *)(numbers + graph->view_places[k]))->prepared = 0;
    for (k = 0; k < graph->n_sides; k++) numbers[graph->sides[k].place] = 0.0;
    if (graph->n_switches) tape_prepare(&graph->switches, numbers + graph->switches_place, p);
    if (graph->n_stops > 1) tape_prepare(&graph->delassus, numbers + graph->delassus_place, p);
    if (graph->orders.n_outputs) tape_prepare(&graph->orders, numbers + graph->orders_place, p);
    for (k = 0; k < graph->n_declared; k++)
        tape_prepare(&graph->resets[k], numbers + graph->reset_places[k], p);
}
