/* Follow the completed execution of a problem from C and print its events, one a line: kind, stop or
   switch where there are several, time and state.

       cc -std=c99 -O2 -ffp-contract=off main.c PROBLEM.c -lm -o PROBLEM && ./PROBLEM

   Without -ffp-contract=off some compilers make one rounding of a product and a sum, and last digits
   differ. A record has the columns of the header. */

#include <stdio.h>
#include <stdlib.h>

#include "PROBLEM.h"

enum { EVENTS = 64, ESTIMATES = 64 };

/* The kind of an event, and the name of its stop or switch. */
static void print_name(const double *row) {
    static const char *const kinds[] = {"impact", "zeno", "release", "", "switch"};
    const int kind = (int)row[0], index = (int)row[5];
    const char *name = (kind == ZL_SWITCH ? PROBLEM_switch_names : PROBLEM_stop_names)[index];
    printf("%s %s", kinds[kind], name);
}

static void print_events(const zl_records *records, long long n_x) {
    const long long width = ZL_EVENT_WIDTH + 2 * n_x;
    long long k, i;
    for (k = 0; k < records->n_events; k++) {
        const double *row = records->events + k * width;
        /* After an impact or a switch there is another state than before. */
        const int jumps = (int)row[0] == ZL_IMPACT || (int)row[0] == ZL_SWITCH;
        const double *state = row + ZL_EVENT_WIDTH + (jumps ? n_x : 0);
        print_name(row);
        printf(" %.17g", row[1]);
        for (i = 0; i < n_x; i++) printf(" %.17g", state[i]);
        printf("\n");
    }
}

/* Take more memory for the estimates of a long sequence of impacts; 0 if there is none. */
static int take_more(zl_records *records, size_t bytes) {
    const long long more = 4 * records->most_estimates;
    double *estimates = realloc(records->estimates, bytes * (size_t)more);
    if (!estimates) return 0;
    records->estimates = estimates;
    records->most_estimates = more;
    return 1;
}

int main(void) {
    const zl_problem *problem = &PROBLEM_problem;
    const long long n_x = problem->n_x;
    const int n_stops = (int)problem->graph->n_stops;
    zl_settings settings[ZL_STOPS];
    zl_run *run = malloc((size_t)zl_size(problem));
    double *events = malloc(sizeof(double) * EVENTS * (size_t)(ZL_EVENT_WIDTH + 2 * n_x));
    const size_t bytes = sizeof(double) * (size_t)(ZL_ESTIMATE_WIDTH + 2 * n_x);
    zl_records records = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0};
    int status, k;
    records.events = events;
    records.most_events = EVENTS;
    records.estimates = malloc(bytes * ESTIMATES);
    records.most_estimates = ESTIMATES;
    if (!run || !events || !records.estimates) return 2;
    for (k = 0; k < n_stops; k++) {
        settings[k] = PROBLEM_settings[k];
        settings[k].records = 0; /* of steps and arcs: only events are wanted */
    }
    status = zl_begin(problem, run, settings, PROBLEM_parameters, PROBLEM_start);
    while (status == ZL_DONE || status == ZL_FULL || status == ZL_CURVE || status == ZL_ESTIMATES) {
        status = zl_resume(problem, run, &records);
        print_events(&records, n_x);
        if (status == ZL_DONE) break;
        /* Impacts are followed one by one. */
        if (status == ZL_CURVE) zl_answer(run, 0, 0.0, 0.0, settings[0].sizes);
        if (status == ZL_ESTIMATES && !take_more(&records, bytes)) break;
    }
    if (status != ZL_DONE) {
        zl_detail detail;
        zl_tell(run, &detail);
        fprintf(stderr, "status %d at %.17g s\n", status, detail.time);
    }
    free(records.estimates);
    free(events);
    free(run);
    return status == ZL_DONE ? 0 : 1;
}
