#include "controller.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#ifdef __FAST_MATH__
#error "-ffast-math breaks what is proved: compile without it"
#endif

#define N JAXTUBE_INPUTS
#define M JAXTUBE_ROWS
#define FARTHEST 1e8 /* m or rad: no pose is so far away */
#define TWO_PI 6.28318530717958647693

typedef jaxtube_real real;

/* The hash of the constants is that of doubles of 64 bits. */
typedef char doubles_have_64_bits[sizeof(double) == 8 ? 1 : -1];

/* A motion of the plane. */
typedef struct {
    double x;
    double y;
    double heading;
} motion;

/* Rows that are met with equality: their numbers, which bound (1 upper, -1 lower), multipliers,
 * normals, and the Cholesky factor of the products of the normals. */
typedef struct {
    int count;
    int rows[N];
    real signs[N];
    real multipliers[N];
    real factor[N][N];
} active_set;

/* The quadratic program at one error. */
typedef struct {
    const jaxtube_program *program;
    real lower[M];
    real upper[M];
    real free[N]; /* z without rows */
    real x[N];
} problem;

static const jaxtube_numbers *const limits = &jaxtube_limits;

#ifdef JAXTUBE_COUNT
unsigned long jaxtube_operations;
#define COUNT(number) (jaxtube_operations += (unsigned long)(number))
#else
#define COUNT(number) ((void)0)
#endif

static real dot(int count, const real *a, const real *b)
{
    real sum = 0;
    for (int i = 0; i < count; i++) {
        sum += a[i] * b[i];
    }
    COUNT(2 * count);
    return sum;
}

/* a += factor b */
static void add(int count, real *a, real factor, const real *b)
{
    for (int i = 0; i < count; i++) {
        a[i] += factor * b[i];
    }
    COUNT(2 * count);
}

static double dot3(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* ---- quadratic program ---- */

/* Divide by the Cholesky factor and by its transpose. */
static void solve(const active_set *active, real *vector)
{
    const int count = active->count;
    for (int i = 0; i < count; i++) {
        vector[i] = (vector[i] - dot(i, active->factor[i], vector)) / active->factor[i][i];
        COUNT(2);
    }
    for (int i = count - 1; i >= 0; i--) {
        vector[i] /= active->factor[i][i];
        add(i, vector, -vector[i], active->factor[i]);
        COUNT(1);
    }
}

/* Factor the products of the normals anew from row `first` on. */
static void factor_from(const problem *of, active_set *active, int first)
{
    for (int i = first; i < active->count; i++) {
        const real *normal = of->program->whitened[active->rows[i]];
        for (int j = 0; j <= i; j++) {
            const real *other = of->program->whitened[active->rows[j]];
            const real product = active->signs[i] * active->signs[j] * dot(N, normal, other);
            const real rest = product - dot(j, active->factor[i], active->factor[j]);
            active->factor[i][j] = j < i ? rest / active->factor[j][j] : (real)sqrt((double)rest);
            COUNT(4);
        }
    }
}

static real bound_of(const problem *of, int row, real sign)
{
    return sign > 0 ? of->upper[row] : -of->lower[row];
}

/* Return by how much z misses the row and bound that it misses most, and which these are. */
static real find_missed(const problem *of, const real *z, int *row, real *sign)
{
    real worst = -INFINITY;
    for (int i = 0; i < M; i++) {
        const real value = dot(N, of->program->whitened[i], z);
        const real above = value - of->upper[i];
        const real below = of->lower[i] - value;
        if (above > worst) {
            worst = above;
            *row = i;
            *sign = 1;
        }
        if (below > worst) {
            worst = below;
            *row = i;
            *sign = -1;
        }
    }
    COUNT(2 * M);
    return worst;
}

/* Add N' weights to z, N being the normals of the active rows. */
static void pull(const problem *of, const active_set *active, real factor, const real *weights,
                 real *z)
{
    for (int i = 0; i < active->count; i++) {
        const real *normal = of->program->whitened[active->rows[i]];
        add(N, z, factor * active->signs[i] * weights[i], normal);
        COUNT(2);
    }
}

static void remove_row(const problem *of, active_set *active, int leaving)
{
    active->count--;
    for (int i = leaving; i < active->count; i++) {
        active->rows[i] = active->rows[i + 1];
        active->signs[i] = active->signs[i + 1];
        active->multipliers[i] = active->multipliers[i + 1];
    }
    factor_from(of, active, leaving);
}

/* Return whether -r and 1 are multipliers of Farkas: no z that a plan may have meets the rows. What
 * keeps the proof from being exact, d and r > 0, counts with the largest such z. */
static int refutes(const problem *of, const active_set *active, const real *r, real bound,
                   real square, real farthest)
{
    real gap = bound + (real)sqrt((double)square) * farthest;
    real sum = 1;
    for (int i = 0; i < active->count; i++) {
        const real *normal = of->program->whitened[active->rows[i]];
        if (r[i] > 0) {
            gap += r[i] * (real)sqrt((double)dot(N, normal, normal)) * farthest;
        } else {
            gap -= r[i] * bound_of(of, active->rows[i], active->signs[i]);
        }
        sum += (real)fabs((double)r[i]);
    }
    COUNT(6 * active->count + 4);
    return gap < -(real)limits->tolerance * sum;
}

/* Find the active rows by the dual method (Goldfarb and Idnani 1983); return a status. */
static int find_active_rows(const problem *of, active_set *active, real farthest, int *exchanges)
{
    const real no_row = -1;
    real z[N];
    int row = 0;
    real sign = 1;
    real multiplier = no_row; /* of the row that is being added */
    memcpy(z, of->free, sizeof z);
    active->count = 0;
    for (*exchanges = 0; *exchanges < JAXTUBE_MOST_EXCHANGES; (*exchanges)++) {
        if (multiplier < 0) {
            if (find_missed(of, z, &row, &sign) <= (real)limits->row_tolerance) {
                return JAXTUBE_SOLVED;
            }
            multiplier = 0;
        }
        const real *normal = of->program->whitened[row];
        const real bound = bound_of(of, row, sign);
        const real missed = sign * dot(N, normal, z) - bound;
        /* The way: multipliers of active rows shrink by r, z moves against d. */
        real r[N];
        for (int i = 0; i < active->count; i++) {
            r[i] = sign * active->signs[i] * dot(N, of->program->whitened[active->rows[i]], normal);
        }
        solve(active, r);
        real d[N];
        for (int i = 0; i < N; i++) {
            d[i] = sign * normal[i];
        }
        pull(of, active, -1, r, d);
        const real square = dot(N, d, d);
        const int moves = square > (real)limits->dependent * dot(N, normal, normal);
        const real full = moves ? (missed > 0 ? missed : 0) / square : (real)INFINITY;
        real part = (real)INFINITY;
        int leaving = 0;
        for (int i = 0; i < active->count; i++) {
            if (r[i] > (real)limits->unmoved && active->multipliers[i] / r[i] < part) {
                part = active->multipliers[i] / r[i];
                leaving = i;
            }
        }
        const real length = full < part ? full : part;
        if (!(length < (real)INFINITY)) {
            return refutes(of, active, r, bound, square, farthest) ? JAXTUBE_INFEASIBLE
                                                                   : JAXTUBE_UNSOLVED;
        }
        if (moves) {
            add(N, z, -length, d);
        }
        add(active->count, active->multipliers, -length, r);
        multiplier += length;
        if (full > part) {
            remove_row(of, active, leaving);
        } else if (active->count == N) {
            return JAXTUBE_UNSOLVED;
        } else {
            active->rows[active->count] = row;
            active->signs[active->count] = sign;
            active->multipliers[active->count] = multiplier;
            active->count++;
            factor_from(of, active, active->count - 1);
            multiplier = no_row;
        }
        COUNT(3 * N + 8 * active->count + 10);
    }
    return JAXTUBE_UNSOLVED;
}

/* Move x from the optimum without rows to that on the active rows, refined once. */
static void move_to_rows(problem *of, const active_set *active)
{
    real shift[N] = {0};
    for (int turn = 0; turn < 2; turn++) {
        real missed[N];
        for (int i = 0; i < active->count; i++) {
            const real *normal = of->program->whitened[active->rows[i]];
            const real value = dot(N, normal, of->free) + dot(N, normal, shift);
            missed[i] =
                active->signs[i] * value - bound_of(of, active->rows[i], active->signs[i]);
            COUNT(3);
        }
        solve(active, missed);
        pull(of, active, -1, missed, shift);
    }
    for (int i = 0; i < N; i++) {
        of->x[i] += dot(N, of->program->unwhiten[i], shift);
    }
    COUNT(N);
}

/* Return whether x meets all rows to a tolerance; a plan that is not a number does not. */
static int meets_rows(const problem *of, real tolerance)
{
    int meets = 1;
    for (int i = 0; i < M; i++) {
        const real value = dot(N, of->program->rows[i], of->x);
        meets &= of->lower[i] - value <= tolerance && value - of->upper[i] <= tolerance;
    }
    COUNT(2 * M);
    return meets;
}

/* Plan from an error; return a status. */
static int make_plan(int window, const double *errors, real *plan, int *exchanges)
{
    problem of;
    active_set active;
    const real start[3] = {(real)errors[0], (real)errors[1], (real)errors[2]};
    of.program = &jaxtube_programs[window];
    for (int i = 0; i < M; i++) {
        const real shift = dot(3, of.program->row_errors[i], start);
        of.lower[i] = of.program->lower[i] - shift;
        of.upper[i] = of.program->upper[i] - shift;
    }
    for (int i = 0; i < N; i++) {
        of.x[i] = dot(3, of.program->free_inputs[i], start);
    }
    COUNT(2 * M);
    *exchanges = 0;
    int status = JAXTUBE_SOLVED;
    if (!meets_rows(&of, 0)) {
        for (int i = 0; i < N; i++) {
            of.free[i] = dot(3, of.program->start[i], start);
        }
        status = find_active_rows(&of, &active, (real)jaxtube_models[window].farthest,
                                  exchanges);
        if (status == JAXTUBE_SOLVED) {
            move_to_rows(&of, &active);
            if (!meets_rows(&of, (real)limits->tolerance)) {
                status = JAXTUBE_UNSOLVED;
            }
        }
    }
    if (status == JAXTUBE_SOLVED) {
        memcpy(plan, of.x, sizeof of.x);
    }
    return status;
}

/* ---- motion ---- */

static motion join(motion first, motion second)
{
    const double c = cos(first.heading);
    const double s = sin(first.heading);
    const motion both = {first.x + c * second.x - s * second.y,
                         first.y + s * second.x + c * second.y, first.heading + second.heading};
    return both;
}

static motion see(motion other, motion from)
{
    const double c = cos(from.heading);
    const double s = sin(from.heading);
    const double x = other.x - from.x;
    const double y = other.y - from.y;
    const motion seen = {c * x + s * y, c * y - s * x, other.heading - from.heading};
    return seen;
}

static motion as_motion(const double *numbers)
{
    const motion made = {numbers[0], numbers[1], numbers[2]};
    return made;
}

static double sinc(double angle)
{
    return fabs(angle) > 1e-4 ? sin(angle) / angle : 1.0 - angle * angle / 6.0;
}

/* The arc on which the wheels travel for a time, s. */
static motion arc(const double *speeds, double time)
{
    const double turn = time * (speeds[0] - speeds[1]) / limits->track_width;
    const double chord = time * (speeds[0] + speeds[1]) / 2.0 * sinc(turn / 2.0);
    const motion along = {chord * cos(turn / 2.0), chord * sin(turn / 2.0), turn};
    return along;
}

/* The motion from the pose to where the commands given will take it. */
static motion find_motion_ahead(const jaxtube_controller *controller)
{
    const double right = controller->expected[0] * limits->lag;
    const double left = controller->expected[1] * limits->lag;
    motion ahead = {(right + left) / 2.0, 0.0, (right - left) / limits->track_width};
    ahead = join(ahead, arc(controller->intended[1], limits->delay_rest));
    for (int i = 2; i < JAXTUBE_DELAY_PERIODS + 2; i++) {
        ahead = join(ahead, arc(controller->intended[i], limits->dt));
    }
    return ahead;
}

/* Take a pose into the estimate of the errors; of the committed pose where wheels lag. */
static void correct_estimate(jaxtube_controller *controller, const double *pose)
{
    const motion reference = as_motion(jaxtube_references[controller->period].pose);
    const motion error = see(see(reference, as_motion(pose)), find_motion_ahead(controller));
    const double measured[3] = {error.x, error.y, remainder(error.heading, TWO_PI)};
    for (int i = 0; i < 3; i++) {
        if (!controller->has_estimate) {
            controller->estimate[i] = measured[i];
            controller->nominal[i] = measured[i];
        }
        controller->estimate[i] +=
            limits->observer_gain[i] * (measured[i] - controller->estimate[i]);
    }
    controller->has_estimate = 1;
}

/* Go to the next period: the estimate, and speeds over ground of wheels that lag. */
static void predict(jaxtube_controller *controller, const double *speeds)
{
    const double *reference = jaxtube_references[controller->period].wheels;
    const motion moved = see(as_motion(controller->estimate), arc(speeds, limits->dt));
    const motion error = join(moved, arc(reference, limits->dt));
    controller->estimate[0] = error.x;
    controller->estimate[1] = error.y;
    controller->estimate[2] = error.heading;
    memmove(controller->intended[0], controller->intended[1],
            (JAXTUBE_DELAY_PERIODS + 1) * sizeof controller->intended[0]);
    memcpy(controller->intended[JAXTUBE_DELAY_PERIODS + 1], speeds,
           sizeof controller->intended[0]);
    const double times[2] = {limits->delay_rest, limits->dt - limits->delay_rest};
    for (int phase = 0; phase < 2; phase++) {
        const double decay = limits->lag > 0 ? exp(-times[phase] / limits->lag) : 0.0;
        for (int i = 0; i < 2; i++) {
            const double command = controller->intended[phase][i];
            controller->expected[i] = command + (controller->expected[i] - command) * decay;
        }
    }
    controller->period++;
}

/* ---- control ---- */

/* Find the inputs of the plan in hand, then of the terminal gain. */
static void follow_plan(jaxtube_controller *controller, int window, double *inputs)
{
    const jaxtube_model *model = &jaxtube_models[window];
    const int has_plan = controller->stage < JAXTUBE_HORIZON;
    double deviation[3];
    double due[2];
    double nominal[3];
    for (int i = 0; i < 3; i++) {
        deviation[i] = controller->estimate[i] - controller->nominal[i];
    }
    for (int i = 0; i < 2; i++) {
        const double *gain = has_plan ? model->tube_gain[i] : model->terminal_gain[i];
        due[i] = has_plan ? (double)controller->plan[2 * controller->stage + i]
                          : dot3(gain, controller->nominal);
        inputs[i] = due[i] + dot3(gain, deviation);
    }
    for (int i = 0; i < 3; i++) {
        nominal[i] = dot3(model->transition[i], controller->nominal) +
                     model->input_matrix[i][0] * due[0] + model->input_matrix[i][1] * due[1];
    }
    memcpy(controller->nominal, nominal, sizeof nominal);
    controller->stage += has_plan;
}

/* Find the wheel speeds that realise inputs by the input map, within the limits. */
static void turn_into_wheels(const jaxtube_controller *controller, const double *inputs,
                             const double *slip, double *wheels)
{
    const double *reference = jaxtube_references[controller->period].wheels;
    const double V = (reference[0] + reference[1]) / 2.0;
    const double Om = (reference[0] - reference[1]) / limits->track_width;
    const double om = Om - inputs[1];
#if JAXTUBE_INPUT_MAP == 2
    const double *errors = controller->estimate;
    const double T = limits->dt;
    const double direction = errors[2] + T * Om / 2.0 - T * om;
    const double half_sine = sin(T * om / 2.0);
    const double travel = T * V * sinc(T * Om / 2.0) * cos(direction) -
                          2.0 * half_sine * half_sine * errors[0] +
                          (sin(T * om) - T * Om) * errors[1];
    const double v = (travel / T - inputs[0]) / fmax(sinc(T * om), 0.1);
#elif JAXTUBE_INPUT_MAP == 1
    const double v = V * cos(controller->estimate[2]) - inputs[0];
#else
    const double v = V - inputs[0];
#endif
    const double turning = limits->track_width / 2.0 * om;
    const double over_ground[2] = {v + turning, v - turning};
    for (int i = 0; i < 2; i++) {
        const double speed = over_ground[i] / (1.0 - slip[i]);
        wheels[i] = fmin(fmax(speed, limits->wheel_limits[0]), limits->wheel_limits[1]);
    }
}

/* ---- watchdog ---- */

static int judge_pose(jaxtube_controller *controller, const jaxtube_input *input)
{
    const double age = input->has_times ? input->now_s - input->stamp_s : 0.0;
    if (!input->has_pose) {
        return JAXTUBE_MISSING;
    }
    for (int i = 0; i < 3; i++) {
        if (!(fabs(input->pose[i]) <= FARTHEST)) {
            return JAXTUBE_INVALID;
        }
    }
    if (!(age >= -limits->most_age && age < (double)INFINITY)) {
        return JAXTUBE_INVALID;
    }
    if (input->has_times) {
        if (controller->has_stamp && !(input->stamp_s > controller->last_stamp_s)) {
            return JAXTUBE_MISSING;
        }
        controller->last_stamp_s = input->stamp_s;
        controller->has_stamp = 1;
    }
    return age <= limits->most_age ? JAXTUBE_USED : JAXTUBE_LATE;
}

/* Return how far a call is from its period's start, counted from the first call; 0 where no call
 * has times, NaN where only some have. */
static double find_lateness(jaxtube_controller *controller, const jaxtube_input *input)
{
    if (!controller->is_begun) {
        controller->is_begun = 1;
        controller->has_times = input->has_times;
        controller->begun_s = input->now_s;
    }
    if (controller->has_times != input->has_times) {
        return (double)NAN;
    }
    const double due = controller->begun_s + controller->period * limits->dt;
    return input->has_times ? fabs(input->now_s - due) : 0.0;
}

/* Choose the slips to compensate; return whether they are those that the certificate is about. */
static int judge_slip(const jaxtube_input *input, double *slip)
{
    int is_usable = 1;
    memcpy(slip, limits->nominal_slip, sizeof limits->nominal_slip);
    if (input->has_slip) {
        for (int i = 0; i < 2; i++) {
            is_usable &= input->slip[i] >= limits->slip_limits[0][i] &&
                         input->slip[i] <= limits->slip_limits[1][i];
        }
        if (is_usable) {
            memcpy(slip, input->slip, sizeof input->slip);
        }
    }
    return is_usable;
}

/* Add the bits of numbers to an FNV-1a hash, the same on machines of either byte order. */
static uint64_t hash_bits(uint64_t hash, double number)
{
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    for (int byte = 0; byte < 8; byte++) {
        hash = (hash ^ ((bits >> (8 * byte)) & 0xffU)) * UINT64_C(1099511628211);
    }
    return hash;
}

static uint64_t hash_doubles(uint64_t hash, const double *numbers, size_t size)
{
    for (size_t i = 0; i < size / sizeof *numbers; i++) {
        hash = hash_bits(hash, numbers[i]);
    }
    return hash;
}

static uint64_t hash_constants(void)
{
    const real *of_programs = (const real *)jaxtube_programs;
    const double choices[] = {JAXTUBE_IS_CERTIFIED, JAXTUBE_DELAY_PERIODS,    JAXTUBE_RESTARTS,
                              JAXTUBE_NEEDS_SLIP,   JAXTUBE_REMEMBERS_WHEELS, JAXTUBE_INPUT_MAP,
                              JAXTUBE_MOST_EXCHANGES};
    uint64_t hash = UINT64_C(14695981039346656037);
    for (const char *digit = JAXTUBE_CERTIFICATE; *digit != 0; digit++) {
        hash = hash_bits(hash, *digit);
    }
    hash = hash_doubles(hash, choices, sizeof choices);
    for (size_t i = 0; i < sizeof jaxtube_programs / (sizeof *of_programs); i++) {
        hash = hash_bits(hash, (double)of_programs[i]);
    }
    hash = hash_doubles(hash, (const double *)jaxtube_models, sizeof jaxtube_models);
    hash = hash_doubles(hash, (const double *)jaxtube_references, sizeof jaxtube_references);
    hash = hash_doubles(hash, (const double *)&jaxtube_limits, sizeof jaxtube_limits);
    for (size_t i = 0; i < JAXTUBE_STEPS; i++) {
        hash = hash_bits(hash, jaxtube_window_of[i]);
    }
    return hash;
}

void jaxtube_restart(jaxtube_controller *controller, int runs)
{
    const int is_sound = controller->is_sound;
    memset(controller, 0, sizeof *controller);
    controller->is_sound = is_sound;
    controller->halted = !is_sound;
    controller->guaranteed =
        is_sound && JAXTUBE_IS_CERTIFIED && (runs || !JAXTUBE_REMEMBERS_WHEELS);
    controller->stage = JAXTUBE_HORIZON;
    if (runs) {
        const double *speeds = jaxtube_references[0].wheels;
        memcpy(controller->expected, speeds, sizeof controller->expected);
        for (int i = 0; i < JAXTUBE_DELAY_PERIODS + 2; i++) {
            memcpy(controller->intended[i], speeds, sizeof controller->intended[i]);
        }
    }
}

int jaxtube_begin(jaxtube_controller *controller, int runs)
{
    controller->is_sound = hash_constants() == jaxtube_constants_hash;
    jaxtube_restart(controller, runs);
    return controller->is_sound ? 0 : -1;
}

/* Find the command of a period whose errors are known. */
static void act(jaxtube_controller *controller, const jaxtube_input *input, double late,
                jaxtube_output *output)
{
    const int window = jaxtube_window_of[controller->period];
    double slip[2];
    output->status = JAXTUBE_BLIND;
    if (output->pose == JAXTUBE_USED) {
        const double *start = JAXTUBE_RESTARTS ? controller->estimate : controller->nominal;
        output->status = make_plan(window, start, controller->plan, &output->exchanges);
    }
    if (output->status == JAXTUBE_SOLVED) {
        controller->stage = 0;
        if (JAXTUBE_RESTARTS) {
            memcpy(controller->nominal, controller->estimate, sizeof controller->nominal);
        }
    }
    const int is_usable = judge_slip(input, slip);
    const int is_inside =
        output->margins[0] >= 0 && output->margins[1] >= 0 && output->margins[2] >= 0;
    const double age = input->has_times ? fabs(input->now_s - input->stamp_s) : 0.0;
    const int is_exact = late <= limits->certified_time && age <= limits->certified_time;
    const int is_told = input->has_slip || !JAXTUBE_NEEDS_SLIP;
    controller->guaranteed = controller->guaranteed && is_exact && is_told && is_usable &&
                             is_inside && output->status == JAXTUBE_SOLVED;
    follow_plan(controller, window, output->inputs);
    turn_into_wheels(controller, output->inputs, slip, output->wheels);
    const double speeds[2] = {output->wheels[0] * (1.0 - slip[0]),
                              output->wheels[1] * (1.0 - slip[1])};
    predict(controller, speeds);
    output->plan_left = JAXTUBE_HORIZON - controller->stage;
    output->guaranteed = controller->guaranteed;
}

int jaxtube_step(jaxtube_controller *controller, const jaxtube_input *input,
                 jaxtube_output *output)
{
    memset(output, 0, sizeof *output);
    const int is_over = controller->period >= JAXTUBE_STEPS;
    const double late = find_lateness(controller, input);
    output->pose = judge_pose(controller, input);
    output->in_time = late <= limits->most_jitter;
    if (output->pose == JAXTUBE_USED && !is_over) {
        correct_estimate(controller, input->pose);
        controller->blind = 0;
    } else {
        controller->blind++;
    }
    if (!controller->is_sound || !controller->has_estimate ||
        controller->blind > JAXTUBE_HORIZON) {
        controller->halted = 1;
    }
    for (int i = 0; i < 3; i++) {
        output->errors[i] = controller->estimate[i];
        output->margins[i] = 1.0 - fabs(controller->estimate[i]) / limits->caps[i];
    }
    if (is_over || controller->halted) {
        controller->guaranteed = 0;
        output->status = is_over ? JAXTUBE_FINISHED : JAXTUBE_HALTED;
    } else {
        act(controller, input, late, output);
    }
    return output->status;
}
