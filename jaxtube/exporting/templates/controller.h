/* A tube-MPC exported by jaxtube, in C99: once a period pose in, wheel speeds out.
 *
 * No memory is allocated, no library but math.h is used, and a step takes a bounded number of
 * operations (JAXTUBE_MOST_OPERATIONS). Define JAXTUBE_FLOAT32 for quadratic programs in floats.
 * README.md has units, statuses, fallbacks and what the guarantee covers.
 */
#ifndef JAXTUBE_CONTROLLER_H
#define JAXTUBE_CONTROLLER_H

#include "constants.h"

/* How the command was found. */
enum {
    JAXTUBE_SOLVED,     /* by a plan that meets all rows */
    JAXTUBE_INFEASIBLE, /* no plan meets all rows: the last one goes on, then the terminal gain */
    JAXTUBE_UNSOLVED,   /* no plan was found: the same */
    JAXTUBE_BLIND,      /* no pose could be used: the same, from the predicted errors */
    JAXTUBE_HALTED,     /* stand still, until jaxtube_restart: no pose for too long */
    JAXTUBE_FINISHED    /* stand still: the reference is at its end */
};

/* What became of the pose. */
enum { JAXTUBE_USED, JAXTUBE_MISSING, JAXTUBE_LATE, JAXTUBE_INVALID };

typedef struct {
    double pose[3]; /* x m, y m, heading rad, in the frame of the reference */
    double stamp_s; /* when it was measured */
    double now_s;   /* when this call is made, by the same clock */
    double slip[2]; /* right, left */
    int has_pose;
    int has_times; /* 0: neither stamp nor now is judged */
    int has_slip;  /* 0: the nominal slips are compensated */
} jaxtube_input;

typedef struct {
    double wheels[2];  /* speeds right, left, m/s, within the limits; 0 to stand still */
    double inputs[2];  /* virtual inputs */
    double errors[3];  /* longitudinal m, lateral m, heading rad: what was acted on */
    double margins[3]; /* share of each cap that the errors leave */
    int status;
    int pose;
    int in_time;    /* the call came at its period's start, counted from the first call */
    int guaranteed; /* since the start nothing has happened that the certificate is not about */
    int plan_left;  /* periods for which a plan is left */
    int exchanges;  /* of active rows */
} jaxtube_output;

typedef struct {
    jaxtube_real plan[JAXTUBE_INPUTS];
    double nominal[3];
    double estimate[3];
    double expected[2];
    double intended[JAXTUBE_DELAY_PERIODS + 2][2];
    double last_stamp_s;
    double begun_s;
    int is_sound;
    int period;
    int stage;
    int blind;
    int has_estimate;
    int has_stamp;
    int is_begun;
    int has_times;
    int guaranteed;
    int halted;
} jaxtube_controller;

#ifdef __cplusplus
extern "C" {
#endif

/* Check the constants, and begin, to be called before the first step; 0, or -1 where they are
 * damaged: every step then halts. `runs` as for jaxtube_restart. */
int jaxtube_begin(jaxtube_controller *controller, int runs);

/* Forget everything: the next call is for the first period of the reference. `runs`, which counts
 * where wheels lag: they already run as the reference begins; 0: they stand still. */
void jaxtube_restart(jaxtube_controller *controller, int runs);

/* Find what the next period is to do; return its status. */
int jaxtube_step(jaxtube_controller *controller, const jaxtube_input *input,
                 jaxtube_output *output);

#ifdef __cplusplus
}
#endif

#endif
