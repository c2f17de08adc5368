/* Whether the code computes as C says: a compiler may have been told to be fast instead. */

/* The first law that does not hold, counted from 1; 0 if all do. `v` holds NaN, infinity, the
   smallest normal number, 1, 1e300, 1 + 2^-30, its square and sin 1, so that nothing is known before
   the code runs. */
int zl_fault(const double *v) {
    if (v[0] == v[0] || fabs(v[1]) <= DBL_MAX || v[1] - v[1] == 0.0) return 1;
    if (v[2] / 2.0 == 0.0) return 2;
    if (v[3] + v[4] - v[4] != 0.0) return 3;
    if (v[5] * v[5] - v[6] != 0.0) return 4;
    if (!(fabs(sin(v[3]) - v[7]) <= 1e-15)) return 5;
    return 0;
}
