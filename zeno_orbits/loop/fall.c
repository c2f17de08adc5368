/* Where in a step a guard first falls through zero: `events` in C, which is the reference. */

enum { DENSE, TRUE_END, DENSE_RATE };

/* A guard inside a step. */
typedef struct Curve {
    /* Guard and its rate at an offset, by dense output or at a true end. */
    void (*look)(const struct Curve *curve, int kind, double offset, double *pair);
    double size;
    int exact; /* dense output is as good as a true end */
} Curve;

/* As Python has them: the first of two, unless the second is smaller (larger). */
static double lesser(double a, double b) { return b < a ? b : a; }
static double greater(double a, double b) { return b > a ? b : a; }

/* A function of the offset and its derivative; NaN where that is not known. */
static void evaluate(const Curve *curve, int kind, double offset, double *pair) {
    curve->look(curve, kind, offset, pair);
    if (kind == DENSE_RATE) {
        pair[0] = pair[1];
        pair[1] = NAN;
    }
}

static double cubic_root(double left, double right, const double *low, const double *high) {
    double drop = 1.0 - high[0] / low[0], at = 1.0 / drop;
    if (!isnan(low[1]) && !isnan(high[1])) {
        double b = low[1] / low[0] * (right - left), end = high[1] / low[0] * (right - left);
        double c = -3.0 * drop - 2.0 * b - end, d = 2.0 * drop + b + end;
        int count;
        for (count = 0; count < CUBIC_STEPS; count++) {
            double rate = b + at * (2.0 * c + at * 3.0 * d);
            double moved = NAN;
            if (rate < 0.0) moved = at - (1.0 + at * (b + at * (c + at * d))) / rate;
            if (!(0.0 < moved && moved < 1.0)) break;
            at = moved;
        }
    }
    return left + at * (right - left);
}

static double root(const Curve *curve, int kind, double left, double right, const double *low,
                   const double *high) {
    double accuracy, close, at, last;
    if (low[0] == 0.0 || left == right) return left;
    if (high[0] == 0.0) return right;
    accuracy = TINY * (right - left);
    close = DOUBLES * (right - left);
    at = cubic_root(left, right, low, high);
    last = right - left;
    while (right - left > accuracy) {
        double pair[2], change;
        evaluate(curve, kind, at, pair);
        if (pair[0] == 0.0) return at;
        if ((pair[0] > 0.0) == (low[0] > 0.0))
            left = at;
        else
            right = at;
        change = !isnan(pair[1]) && pair[1] != 0.0 ? -pair[0] / pair[1] : INFINITY;
        if (fabs(change) <= close) return lesser(greater(at + change, left), right);
        if (left < at + change && at + change < right && fabs(change) < last / 2) {
            at = at + change;
            last = fabs(change);
        } else {
            at = (left + right) / 2;
            last = (right - left) / 2;
            if (at == left || at == right) break;
        }
    }
    return (left + right) / 2;
}

static double slow_root(const Curve *curve, double offset) {
    double width = POLISH * curve->size;
    while (width < curve->size) {
        double left = greater(offset - width, 0.0), right = lesser(offset + width, curve->size);
        double low[2], high[2];
        evaluate(curve, TRUE_END, left, low);
        evaluate(curve, TRUE_END, right, high);
        if (low[0] > 0.0 && 0.0 > high[0]) return root(curve, TRUE_END, left, right, low, high);
        width *= 4;
    }
    return offset;
}

static double polished(const Curve *curve, double offset) {
    int count;
    if (curve->exact) return offset;
    for (count = 0; count < 4; count++) {
        double pair[2], change, moved;
        evaluate(curve, TRUE_END, offset, pair);
        change = pair[1] < 0.0 ? -pair[0] / pair[1] : 0.0;
        moved = lesser(greater(offset + change, 0.0), curve->size);
        if (fabs(moved - offset) > POLISH * curve->size) return slow_root(curve, offset);
        if (fabs(moved - offset) <= DOUBLES * curve->size) return moved;
        offset = moved;
    }
    return offset;
}

static double short_rise(const Curve *curve) {
    double right = curve->size, high[2];
    int count;
    evaluate(curve, DENSE, right, high);
    for (count = 0; count < HALVINGS; count++) {
        double left = right / 2, low[2];
        evaluate(curve, DENSE, left, low);
        if (low[0] > 0.0) return polished(curve, root(curve, DENSE, left, right, low, high));
        right = left;
        high[0] = low[0];
        high[1] = low[1];
    }
    return NAN;
}

/* Where in a step the guard first falls through zero; NaN if it does not. */
static double first_fall(const Curve *curve, const double *before, const double *after,
                         int on_guard) {
    double size = curve->size;
    double second = before[0] + size / 3 * before[1], third = after[0] - size / 3 * after[1];
    int started = before[0] > 0.0 || (on_guard && before[0] == 0.0 && before[1] > 0.0);
    int dips = before[1] < 0.0 && 0.0 < after[1] &&
               !(second > before[0] / 2 && before[0] / 2 > 0.0 && third > after[0] / 2 &&
                 after[0] / 2 > 0.0);
    int falls_once, armed = !on_guard, k;
    double left = 0.0, left_pair[2] = {before[0], before[1]};
    if (started && second > 0.0 && third > 0.0 && after[0] > 0.0 && !dips) return NAN;
    falls_once = before[0] > 0.0 && 0.0 > after[0] && (second > 0.0 || third < 0.0);
    if (!on_guard && falls_once) {
        double middle[2], expected = (before[0] + after[0]) / 2 + size * (before[1] - after[1]) / 8;
        evaluate(curve, DENSE, size / 2, middle);
        if (fabs(middle[0] - expected) < CUBIC * (fabs(before[0]) + fabs(after[0]))) {
            double found = middle[0] > 0.0 ? root(curve, DENSE, size / 2, size, middle, after)
                                           : root(curve, DENSE, 0.0, size / 2, before, middle);
            return polished(curve, found);
        }
    }
    for (k = 1; k <= 8; k++) {
        double offset = k < 8 ? size * (k / 8.0) : size, pair[2];
        evaluate(curve, DENSE, offset, pair);
        if (armed && pair[0] < 0.0)
            return polished(curve, root(curve, DENSE, left, offset, left_pair, pair));
        if (armed && left_pair[1] < 0.0 && 0.0 < pair[1]) {
            double falling[2] = {left_pair[1], NAN}, rising[2] = {pair[1], NAN}, low_pair[2];
            double lowest = root(curve, DENSE_RATE, left, offset, falling, rising);
            evaluate(curve, DENSE, lowest, low_pair);
            if (low_pair[0] < 0.0)
                return polished(curve, root(curve, DENSE, left, lowest, left_pair, low_pair));
        }
        armed = armed || pair[0] > 0.0;
        left = offset;
        left_pair[0] = pair[0];
        left_pair[1] = pair[1];
    }
    if (armed || after[0] >= 0.0) return NAN;
    return short_rise(curve);
}
