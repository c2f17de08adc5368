/* Eigenvalues of a real matrix by rows, destroyed; real parts, then imaginary. 0 if none came.
   Elimination to Hessenberg form, then Francis' double steps [GolubVanLoan, 7.5]. */
static int eigenvalues(int n, double a[][ZL_MOST], double *real, double *imaginary) {
    int i, j, k, m, last = n - 1, count = 0;
    double norm = 0.0, shift = 0.0;
    for (m = 1; m < n - 1; m++) {
        double largest = 0.0;
        int pivot = m;
        for (i = m; i < n; i++)
            if (fabs(a[i][m - 1]) > fabs(largest)) {
                largest = a[i][m - 1];
                pivot = i;
            }
        if (largest == 0.0) continue;
        if (pivot != m) {
            for (j = m - 1; j < n; j++) {
                double kept = a[pivot][j];
                a[pivot][j] = a[m][j];
                a[m][j] = kept;
            }
            for (j = 0; j < n; j++) {
                double kept = a[j][pivot];
                a[j][pivot] = a[j][m];
                a[j][m] = kept;
            }
        }
        for (i = m + 1; i < n; i++) {
            double factor = a[i][m - 1] / largest;
            if (factor == 0.0) continue;
            a[i][m - 1] = 0.0;
            for (j = m; j < n; j++) a[i][j] -= factor * a[m][j];
            for (j = 0; j < n; j++) a[j][m] += factor * a[j][i];
        }
    }
    for (i = 0; i < n; i++)
        for (j = i > 0 ? i - 1 : 0; j < n; j++) norm += fabs(a[i][j]);
    if (norm == 0.0) norm = 1.0;
    while (last >= 0) {
        double x, y, w, p = 0.0, q = 0.0, r = 0.0;
        int low;
        for (low = last; low > 0; low--) {
            double size = fabs(a[low - 1][low - 1]) + fabs(a[low][low]);
            if (size == 0.0) size = norm;
            if (fabs(a[low][low - 1]) <= DBL_EPSILON * size) {
                a[low][low - 1] = 0.0;
                break;
            }
        }
        x = a[last][last];
        if (low == last) {
            real[last] = x + shift;
            imaginary[last] = 0.0;
            last--;
            count = 0;
            continue;
        }
        y = a[last - 1][last - 1];
        w = a[last][last - 1] * a[last - 1][last];
        if (low == last - 1) {
            double half = (y - x) / 2, square = half * half + w, z = sqrt(fabs(square));
            x += shift;
            if (square >= 0.0) {
                z = half + (half >= 0.0 ? z : -z);
                real[last - 1] = x + z;
                real[last] = z != 0.0 ? x - w / z : x + z;
                imaginary[last - 1] = imaginary[last] = 0.0;
            } else {
                real[last - 1] = real[last] = x + half;
                imaginary[last - 1] = z;
                imaginary[last] = -z;
            }
            last -= 2;
            count = 0;
            continue;
        }
        if (++count > 60) return 0;
        if (count % 10 == 0) {
            double size = fabs(a[last][last - 1]) + fabs(a[last - 1][last - 2]);
            shift += x;
            for (i = 0; i <= last; i++) a[i][i] -= x;
            x = y = 0.75 * size;
            w = -0.4375 * size * size;
        }
        for (m = last - 2; m >= low; m--) {
            double z = a[m][m], right = x - z, left = y - z, size;
            p = (right * left - w) / a[m + 1][m] + a[m][m + 1];
            q = a[m + 1][m + 1] - z - right - left;
            r = a[m + 2][m + 1];
            size = fabs(p) + fabs(q) + fabs(r);
            p /= size;
            q /= size;
            r /= size;
            if (m == low) break;
            if (fabs(a[m][m - 1]) * (fabs(q) + fabs(r)) <=
                DBL_EPSILON * fabs(p) *
                    (fabs(a[m - 1][m - 1]) + fabs(z) + fabs(a[m + 1][m + 1])))
                break;
        }
        for (i = m + 2; i <= last; i++) {
            a[i][i - 2] = 0.0;
            if (i > m + 2) a[i][i - 3] = 0.0;
        }
        for (k = m; k < last; k++) {
            int three = k < last - 1;
            double length, size = 1.0, u, v, t;
            if (k > m) {
                p = a[k][k - 1];
                q = a[k + 1][k - 1];
                r = three ? a[k + 2][k - 1] : 0.0;
                size = fabs(p) + fabs(q) + fabs(r);
                if (size == 0.0) continue;
                p /= size;
                q /= size;
                r /= size;
            }
            length = sqrt(p * p + q * q + r * r);
            if (p < 0.0) length = -length;
            if (length == 0.0) continue;
            if (k > m)
                a[k][k - 1] = -length * size;
            else if (low != m)
                a[k][k - 1] = -a[k][k - 1];
            p += length;
            t = p / length;
            u = q / length;
            v = r / length;
            q /= p;
            r /= p;
            for (j = k; j <= last; j++) {
                double sum = a[k][j] + q * a[k + 1][j];
                if (three) {
                    sum += r * a[k + 2][j];
                    a[k + 2][j] -= sum * v;
                }
                a[k + 1][j] -= sum * u;
                a[k][j] -= sum * t;
            }
            for (i = low; i <= (last < k + 3 ? last : k + 3); i++) {
                double sum = t * a[i][k] + u * a[i][k + 1];
                if (three) {
                    sum += v * a[i][k + 2];
                    a[i][k + 2] -= sum * r;
                }
                a[i][k + 1] -= sum * q;
                a[i][k] -= sum;
            }
        }
    }
    return 1;
}
