/* Replay recorded steps: main steps.csv [tolerance]
 *
 * A line holds has_pose, x, y, heading, stamp, now, has_slip, right slip, left slip, then what the
 * controller that made the record found: right wheel, left wheel, status; an empty line begins anew.
 * Exit 1 where a wheel speed differs by more than the tolerance, m/s, or a status differs.
 */
#define _POSIX_C_SOURCE 199309L

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "controller.h"

#define MOST_STEPS 1000000

static double durations[MOST_STEPS];

static double read_clock(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec * 1e6 + (double)now.tv_nsec * 1e-3;
}

static int compare(const void *left, const void *right)
{
    const double a = *(const double *)left;
    const double b = *(const double *)right;
    return (a > b) - (a < b);
}

static int read_step(const char *line, jaxtube_input *input, double *wheels, int *status)
{
    return sscanf(line, "%d,%lf,%lf,%lf,%lf,%lf,%d,%lf,%lf,%lf,%lf,%d", &input->has_pose,
                  &input->pose[0], &input->pose[1], &input->pose[2], &input->stamp_s, &input->now_s,
                  &input->has_slip, &input->slip[0], &input->slip[1], &wheels[0], &wheels[1],
                  status) == 12;
}

int main(int count, char **arguments)
{
    static jaxtube_controller controller;
    char line[1024];
    int steps = 0;
    int wrong = 0;
    int of_status[6] = {0};
    double worst = 0.0;
    const double tolerance = count > 2 ? atof(arguments[2]) : 1e-9;
    FILE *file = count > 1 ? fopen(arguments[1], "r") : NULL;
    if (file == NULL) {
        fprintf(stderr, "usage: %s steps.csv [tolerance]\n", arguments[0]);
        return 2;
    }
    if (jaxtube_begin(&controller, 1) != 0) {
        fprintf(stderr, "the constants are damaged; export the controller again\n");
        fclose(file);
        return 2;
    }
    while (fgets(line, sizeof line, file) != NULL && steps < MOST_STEPS) {
        jaxtube_input input = {.has_times = 1};
        jaxtube_output output;
        double wheels[2];
        int status;
        if (line[0] == '\n' || line[0] == '#') {
            jaxtube_restart(&controller, 1);
            continue;
        }
        if (!read_step(line, &input, wheels, &status)) {
            fprintf(stderr, "%s: no step: %s", arguments[1], line);
            fclose(file);
            return 2;
        }
        const double begun = read_clock();
        jaxtube_step(&controller, &input, &output);
        durations[steps] = read_clock() - begun;
        const double differs =
            fmax(fabs(output.wheels[0] - wheels[0]), fabs(output.wheels[1] - wheels[1]));
        worst = fmax(worst, differs);
        wrong += !(differs <= tolerance) || output.status != status;
        of_status[output.status]++;
        steps++;
    }
    fclose(file);
    if (steps == 0) {
        fprintf(stderr, "%s: holds no steps\n", arguments[1]);
        return 2;
    }
    qsort(durations, (size_t)steps, sizeof durations[0], compare);
    printf("steps %d, wrong %d, largest difference of a wheel speed %.3g m/s\n", steps, wrong, worst);
    printf("solved %d, infeasible %d, unsolved %d, blind %d, halted %d, finished %d\n", of_status[0],
           of_status[1], of_status[2], of_status[3], of_status[4], of_status[5]);
    printf("a step takes %.3g us (median), %.3g us (99.9 %%), %.3g us (worst)\n",
           durations[steps / 2], durations[(int)(0.999 * steps)], durations[steps - 1]);
    printf("operations of floating point in a plan: %lu at most\n", JAXTUBE_MOST_OPERATIONS);
    printf("certificate %s\n", JAXTUBE_CERTIFICATE);
    return wrong > 0;
}
