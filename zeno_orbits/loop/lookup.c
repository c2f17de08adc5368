/* Look-ups in tables: `expressions/lookups.py` has the same comparisons and the numbers of a table. */

/* Places in a table: cells, first and last knot, buckets, whether it refuses what is outside of its
   knots, and whether its knots are phases of a turn; knots, and first cells of buckets, follow. */
enum { T_CELLS, T_FIRST, T_LAST, T_BUCKETS, T_REFUSES, T_TURNS, T_KNOTS };

/* Cells that are found: all, or those of one parity, beyond their ends up to the middle of others. */
enum { SIDE_ALL, SIDE_EVEN, SIDE_ODD, SIDES };

/* The last cell that begins at or below x, or the first one. */
static long long plain_cell(const double *table, double x) {
    const double *knots = table + T_KNOTS;
    const long long n = (long long)table[T_CELLS], buckets = (long long)table[T_BUCKETS];
    const double *starts = knots + n + 1;
    const double share = (x - table[T_FIRST]) / (table[T_LAST] - table[T_FIRST]);
    long long low = 0, high = n - 1, bucket;
    if (share >= 0.0 && share < 1.0) {
        bucket = (long long)(share * (double)buckets);
        low = (long long)starts[bucket];
        if (!(knots[low] <= x)) low = 0;
        if (bucket + 2 < buckets) high = (long long)starts[bucket + 2] + 2;
        if (high > n - 1 || knots[high] <= x) high = n - 1;
    } else if (!(share >= 1.0)) {
        return 0;
    }
    while (low < high) {
        const long long middle = high - low > 4 ? low + (high - low + 1) / 2 : low + 1;
        if (knots[middle] <= x)
            low = middle;
        else if (middle == low + 1)
            break;
        else
            high = middle - 1;
    }
    return low;
}

/* The cell of a value, a code of table and side; not a number if there is none. */
static double cell_of(const double *const *tables, double code, double x) {
    const int side = (int)code % SIDES;
    const double *table = tables[(int)code / SIDES], *knots = table + T_KNOTS;
    const long long n = (long long)table[T_CELLS];
    long long k;
    if (isnan(x) || (table[T_REFUSES] != 0.0 && (x < table[T_FIRST] || x > table[T_LAST])))
        return NAN;
    k = plain_cell(table, x);
    if (side != SIDE_ALL && n > 1 && (k % 2 == 1) != (side == SIDE_ODD)) {
        const int is_left = 2.0 * x < knots[k] + knots[k + 1];
        if (table[T_TURNS] != 0.0)
            k = (k + (is_left ? n - 1 : 1)) % n;
        else
            k += k == 0 || (k != n - 1 && !is_left) ? 1 : -1;
    }
    return (double)k;
}

/* The same of a phase, by cosine and sine. */
static double cell_of_turn(const double *const *tables, double code, double c, double s) {
    const double angle = atan2(s, c);
    return cell_of(tables, code, angle < 0.0 ? angle + tables[(int)code / SIDES][T_LAST] : angle);
}

/* The number of a cell in a column that begins at a place of a table. */
static double number_of_cell(const double *const *tables, double which, double place, double cell) {
    return isnan(cell) ? NAN : tables[(int)which][(long long)place + (long long)cell];
}
