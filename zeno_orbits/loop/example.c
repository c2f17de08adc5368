/* Follow the completed execution of a problem from C and print its events, one a line.

       cc -std=c99 -O2 -ffp-contract=off main.c PROBLEM.c -lm -o PROBLEM && ./PROBLEM

   Without -ffp-contract=off some compilers make one rounding of a product and a sum, and last digits
   differ. A record has the columns of the header, kinds of events are ZL_IMPACT, ZL_ZENO, ZL_RELEASE. */

#include <stdio.h>
#include <stdlib.h>

#include "PROBLEM.h"

enum { EVENTS = 64, ESTIMATES = 4096 };

static void print_events(const zl_records *records, long long n_x) {
    static const char *const names[] = {"impact", "zeno", "release"};
    const long long width = ZL_EVENT_WIDTH + 2 * n_x;
    long long k, i;
    for (k = 0; k < records->n_events; k++) {
        const double *row = records->events + k * width;
        /* After an impact there is another state than before. */
        const double *state = row + ZL_EVENT_WIDTH + ((int)row[0] == ZL_IMPACT ? n_x : 0);
        printf("%s %.17g", names[(int)row[0]], row[1]);
        for (i = 0; i < n_x; i++) printf(" %.17g", state[i]);
        printf("\n");
    }
}

int main(void) {
    const zl_problem *problem = &PROBLEM_problem;
    const long long n_x = problem->n_x;
    zl_settings settings = PROBLEM_settings;
    zl_run *run = malloc((size_t)zl_size(problem));
    double *events = malloc(sizeof(double) * EVENTS * (size_t)(ZL_EVENT_WIDTH + 2 * n_x));
    double *estimates = malloc(sizeof(double) * ESTIMATES * (size_t)(ZL_ESTIMATE_WIDTH + 2 * n_x));
    zl_records records = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0};
    int status;
    if (!run || !events || !estimates) return 2;
    records.events = events;
    records.most_events = EVENTS;
    records.estimates = estimates;
    records.most_estimates = ESTIMATES;
    settings.records = 0; /* of steps and arcs: only events are wanted */
    status = zl_begin(problem, run, &settings, PROBLEM_parameters, PROBLEM_start);
    while (status == ZL_DONE || status == ZL_FULL || status == ZL_CURVE) {
        status = zl_resume(problem, run, &records);
        print_events(&records, n_x);
        if (status == ZL_DONE) break;
        /* Impacts are followed one by one. */
        if (status == ZL_CURVE) zl_answer(run, 0, 0.0, 0.0, PROBLEM_settings.sizes);
    }
    if (status != ZL_DONE) {
        zl_detail detail;
        zl_tell(run, &detail);
        fprintf(stderr, "status %d at %.17g s\n", status, detail.time);
    }
    free(estimates);
    free(events);
    free(run);
    return status == ZL_DONE ? 0 : 1;
}
