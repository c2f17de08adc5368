/* Falls of a guard that samples of it miss: `guard_net` in C, which is the reference. */

typedef struct {
    double offset, pair[2], state[ZL_MOST];
} Place;

typedef struct {
    const Curve *curve;
    int is_carried; /* the guard is a state, beside its formula */
    int returns; /* it may rise from its root and fall more than once, as of a table of short cells */
    /* State and guard inside a step as dense output has them. */
    void (*state_at)(const Curve *curve, double offset, double *state, double *pair);
    /* Bounds of the guard and of two derivatives over a box that holds a piece of the step; not of
       all, those of a guard that is positive there are enough. */
    void (*bounds)(const Curve *curve, const Place *left, const Place *right, int all,
                   double *found);
} Net;

/* Bounds of the rate of a guard in a piece, from those of it and of its own rate. */
static void piece_rates(const double *bounds, double width, const Place *left, const Place *right,
                        double *rates) {
    double falling = lesser(bounds[4] * width, 0.0), rising = greater(bounds[5] * width, 0.0);
    rates[0] = greater(greater(bounds[2], left->pair[1] + falling), right->pair[1] - rising);
    rates[1] = lesser(lesser(bounds[3], left->pair[1] + rising), right->pair[1] - falling);
}

/* Whether a guard that is not negative at both ends of a piece has no fall inside. */
static int is_excluded(const double *bounds, double width, const Place *left, const Place *right) {
    double rates[2], at, bend = bounds[5], low = left->pair[0], change = right->pair[0] - low;
    if (bounds[0] > 0.0) return 1;
    piece_rates(bounds, width, left, right, rates);
    if (rates[0] >= 0.0 || rates[1] <= 0.0) return 1;
    at = (change - rates[1] * width) / (rates[0] - rates[1]);
    if (low + rates[0] * at > 0.0) return 1;
    at = bend > 0.0 ? width / 2 - change / (bend * width) : 0.0;
    if (!(0.0 < at && at < width)) return 1;
    return low + change * at / width - bend / 2 * at * (width - at) > 0.0;
}

/* Whether a guard that is a state differs from its formula, as over a bump unseen. */
static int is_denied(const Net *net, const Place *place, double width) {
    double found[6], value = place->pair[0], rate = place->pair[1];
    double off = AGREE * (fabs(value) + fabs(rate) * width);
    double off_rate = AGREE * (fabs(rate) + fabs(value) / width);
    net->bounds(net->curve, place, place, 1, found);
    return !(found[0] - off <= value && value <= found[1] + off && found[2] - off_rate <= rate &&
             rate <= found[3] + off_rate);
}

static double root_between(const Net *net, const Place *left, const Place *right) {
    return polished(net->curve, root(net->curve, DENSE, left->offset, right->offset, left->pair,
                                     right->pair));
}

/* Where in a step the guard first falls through zero, if samples found it, NaN else, or not. */
static double first_of_all(const Net *net, const double *before, const double *after,
                           const double *state_before, const double *state_after, double fall,
                           int on_guard, double rounding) {
    double size = net->curve->size;
    Place left, right, waiting[64];
    int n = 1, count;
    if (on_guard && after[0] <= rounding && !(net->returns && before[1] * size > rounding))
        return fall;
    left.offset = 0.0;
    memcpy(left.pair, before, sizeof left.pair);
    memcpy(left.state, state_before, sizeof left.state);
    waiting[0].offset = size;
    memcpy(waiting[0].pair, after, sizeof left.pair);
    memcpy(waiting[0].state, state_after, sizeof left.state);
    if (!isnan(fall)) {
        waiting[0].offset = fall;
        net->state_at(net->curve, fall, waiting[0].state, waiting[0].pair);
        waiting[0].pair[0] = 0.0;
    }
    for (count = 0; n > 0 && count < MOST_PIECES; count++) {
        double width, near, bounds[6], rates[2];
        int starts, changes, rises, is_zero;
        Place middle;
        right = waiting[n - 1];
        width = right.offset - left.offset;
        starts = on_guard && left.offset == 0.0;
        /* A guard that rises from its zero and is negative further on has fallen in between. */
        rises = starts && left.pair[1] * size > rounding;
        changes = right.pair[0] < 0.0 && 0.0 < left.pair[0] && !rises;
        near = rises ? NEAR_START * NEAR_START : NEAR_START;
        net->bounds(net->curve, &left, &right, right.pair[0] < 0.0, bounds);
        piece_rates(bounds, width, &left, &right, rates);
        if (changes && rates[1] < 0.0) return root_between(net, &left, &right);
        if ((right.pair[0] >= 0.0 && is_excluded(bounds, width, &left, &right)) ||
            (starts && width <= near * size && !(rises && right.pair[0] < 0.0))) {
            left = right;
            n--;
            continue;
        }
        is_zero = greater(left.pair[0], right.pair[0]) <= rounding && !rises;
        if (width <= NARROWEST * size || is_zero) {
            if (changes) return root_between(net, &left, &right);
            left = right;
            n--;
            continue;
        }
        middle.offset = (left.offset + right.offset) / 2;
        net->state_at(net->curve, middle.offset, middle.state, middle.pair);
        if (net->is_carried && is_denied(net, &middle, width)) return left.offset;
        if (starts && middle.pair[0] <= 0.0 && !rises) {
            left = right;
            n--;
        } else if (middle.pair[0] < 0.0) {
            waiting[0] = middle;
            n = 1;
        } else {
            waiting[n++] = middle;
        }
    }
    return fall;
}
