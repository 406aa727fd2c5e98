/* The closed loop of coil and valve, hand-written for speed: the yardstick of fastcoil's own kernel.

Blocks of LANES scenarios side by side, struct of arrays, all state of a block in L1.  Loops over lanes are
plain C that gcc vectorises; the constants of the plant (C_W, BETA1, ...) come as macros from c_peer.py.  What
pays, as measured with 512-bit vectors on a Zen 5, the last also on an Emerald Rapids:
  - saturation in a loop of its own: two short dependency chains overlap better than a long one;
  - polynomials in two halves (even and odd powers), for the same reason; the valve in four loops;
  - humidity ratios in units of 0.621945 kg/kg and enthalpies over 1.006 kJ/(kg K), which makes the factors
    of saturation and of sensible heat vanish; the heat capacities stand in the conductances;
  - vdivpd stays: two divisions beside 24 multiply-adds cost less than Newton steps on the multipliers;
  - air-side effectiveness once per second for all blocks; valve and water side only when a stem moved;
  - no saturation, division or enthalpy in volumes whose metal is too warm to get wet in any lane.
What does not: state in registers over the volumes of 8 or 16 lanes, other layouts and paddings of the rows, a
polynomial for W_s itself (degree 14) without the division.
Sums for every metric that the work has: SUMS, from c_peer.py, which also says what a second counts for (flags).
CONVERGED: the march, 1 for the converged one, 0 for the printed one.
Without sums: frost, because the caller has made sure that nothing comes near freezing, and the estimate, which is
constant here. */
#include <math.h>
#include <stdint.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline))
#define EACH_LANE for (int j = 0; j < LANES; j++)

/* elementary functions: round-off accuracy, branch-free */

#define LN2_HIGH 0x1.62e42fee00000p-1
#define LN2_LOW 0x1.a39ef35793c76p-33
#define ROUNDER 6755399441055744.0 /* 1.5 * 2^52: adding it rounds to an integer, left in the low bits */

INLINE double min(double a, double b) { return a < b ? a : b; }
INLINE double max(double a, double b) { return a > b ? a : b; }
INLINE double clip(double x) { return min(max(x, 0.0), 1.0); }

INLINE uint64_t bits(double x) {
    uint64_t b;
    memcpy(&b, &x, sizeof b);
    return b;
}

INLINE double from_bits(uint64_t b) {
    double x;
    memcpy(&x, &b, sizeof x);
    return x;
}

/* e^x for |x| < 700; Chebyshev interpolant of degree 11, 1.6e-17 relative */
INLINE double exp_(double x) {
    double shifted = x * 1.4426950408889634 + ROUNDER, n = shifted - ROUNDER;
    double r = (x - n * LN2_HIGH) - n * LN2_LOW, z = r * r;
    double odd = 2.51003767988125e-08, even = 2.762007713646922e-07;
    odd = odd * z + 2.7557268478279004e-06;
    even = even * z + 2.480152131972762e-05;
    odd = odd * z + 0.00019841269863041851;
    even = even * z + 0.0013888888917198419;
    odd = odd * z + 0.008333333333330065;
    even = even * z + 0.04166666666662416;
    odd = odd * z + 0.16666666666666669;
    even = even * z + 0.5;
    double p = (odd * r + even) * z + r + 1.0;
    return p * from_bits((bits(shifted) << 52) + 0x3FF0000000000000u);
}

/* ln x for normal x > 0: 2 atanh(s) with s = (m - 1)/(m + 1), x = 2^n m; 5e-18 relative */
INLINE double log_(double x) {
    uint64_t b = bits(x), exponent = (b - 0x3FE6A09E667F3BCDu) & 0xFFF0000000000000u;
    double n = from_bits((uint64_t)((int64_t)exponent >> 52) + bits(ROUNDER)) - ROUNDER;
    double f = from_bits(b - exponent) - 1.0, s = f / (2.0 + f), z = s * s;
    double p = 0.07308292712444311;
    p = p * z + 0.07665855309105386;
    p = p * z + 0.09091444727837474;
    p = p * z + 0.11111105565129939;
    p = p * z + 0.14285714313001635;
    p = p * z + 0.19999999999949722;
    p = p * z + 0.3333333333333335;
    return n * LN2_HIGH + (n * LN2_LOW + s * (2.0 * z * p - f) + f);
}

INLINE double effectiveness(double factor, double exponent, double log_m) {
    return 1.0 - exp_(-factor * exp_(exponent * log_m));
}

/* moist air: omega = W/0.621945 = p_w/(p - p_w);  eta = h/1.006 = T + omega L(T) */

#define MASS_RATIO 0.621945
#define CP_AIR 1.006

INLINE double latent(double T) { return 2501.0 * MASS_RATIO / CP_AIR + 1.86 * MASS_RATIO / CP_AIR * T; }

/* p_ws is the package's polynomial, in T - 25 degC instead of (T - 25)/25 */
INLINE double saturation_omega(double T) {
    double x = min(max(T, 0.01), 50.0) - 25.0, z = x * x;
    double even = 6.337648701247728e-19, odd = 4.843596783206398e-16;
    even = even * z - 5.599997570513242e-14;
    odd = odd * z - 3.033126995240478e-11;
    even = even * z + 2.8276007599474576e-09;
    odd = odd * z + 2.825027978650763e-06;
    even = even * z + 0.0006149997625258774;
    odd = odd * z + 0.07159297906653218;
    even = even * z + 4.9126433071487305;
    odd = odd * z + 188.9310647032762;
    even = even * z + 3169.2164701436113;
    double p_ws = odd * x + even;
    return p_ws / (PRESSURE - p_ws);
}

typedef struct {
    const double *kp, *ti, *sample_time, *backlash, *estimate;
} scenarios;

typedef struct {
    const double *m_a, *T_a_in, *W_a_in, *T_w_in, *T_set;
    const int64_t *flags;
    const double *eps_a, *eps_star, *T_dry;
    long n_steps;
} day;

enum { SUMS, N_SUMS };

typedef struct {
    /* parameters */
    double kp[LANES], ki[LANES], sample_time[LANES], x_bl[LANES], alpha[LANES], x_hat[LANES];
    /* controller, valve */
    double next_sample[LANES], integral[LANES], u[LANES], mode[LANES], u_ext[LANES], command[LANES], q[LANES];
    /* water side: dt C_flow/C_w, dt G_w/C_w, dt G_w/C_c, half a step of the water; scratch of deliver() */
    double flow[LANES], to_water[LANES], from_metal[LANES], half_w[LANES], scratch[LANES];
    /* coil: water temperature of the volume before, states, saturation; row N of the air is what enters */
    double T_w_in[LANES], T_w[N][LANES], T_c[N][LANES], T_a[N + 1][LANES], omega[N + 1][LANES];
    double omega_s[LANES], heat[N][LANES]; /* from the air, dt Q/C_c */
    /* what the sums compare with */
    double last_turn[LANES], power_block[LANES], highest[LANES], lowest[LANES];
    double signal[5][LANES], product[27][LANES]; /* of the swing: 1, g, g lagged once and twice, h */
    double weight[LANES], direction[LANES], extreme[LANES], e_mean[LANES], d[LANES], d_mean[LANES];
    double up_at[LANES], last_period[LANES];
    double sum[N_SUMS][LANES];
} block;

/* PI, backlash inverse and Eq (1) at a sample, with the movements if they count; returns whether a stem moved */
INLINE uint64_t control(block *b, double t, double T_set, double counts, int counted, int together) {
    uint64_t moved = 0;
    EACH_LANE {
        double e = b->T_a[0][j] - T_set;
        double integral = clip(b->integral[j] + b->ki[j] * e), u = clip(b->kp[j] * e + integral);
        if (!together) {
            int due = b->next_sample[j] == t;
            integral = due ? integral : b->integral[j];
            u = due ? u : b->u[j];
            b->u[j] = u;
            b->next_sample[j] += due ? b->sample_time[j] : 0.0;
        }
        b->integral[j] = integral;

        double mode = b->mode[j], u_ext = b->u_ext[j], advance = mode * (u - u_ext);
        int turned = advance < -BUFFER;
        mode = turned ? -mode : mode;
        double extreme = (turned | (advance > 0.0)) ? u : u_ext;
        double command = clip((1.0 - b->x_hat[j]) * extreme + (mode > 0.0 ? b->x_hat[j] : 0.0));
        command = extreme != u_ext ? command : b->command[j];
        double q = min(max(b->q[j], command - b->x_bl[j]), command);
        moved |= bits(q) ^ bits(b->q[j]);
        if (counted) {
            double d_opening = b->alpha[j] * (q - b->q[j]), turn = d_opening > 0.0 ? 1.0 : -1.0;
            int moves = fabs(d_opening) > MOVED;
            b->sum[STEM_TRAVEL][j] += fabs(d_opening);
            b->sum[MOTOR_TRAVEL][j] += fabs(command - b->command[j]);
            b->sum[REVERSALS][j] += moves & (turn * b->last_turn[j] < 0.0) ? 1.0 : 0.0;
            b->last_turn[j] = moves ? turn : b->last_turn[j];
            b->sum[SWITCHES][j] += turned ? counts : 0.0;
        }
        b->mode[j] = mode;
        b->u_ext[j] = extreme;
        b->command[j] = command;
        b->q[j] = q;
    }
    return moved;
}

/* Eq (2) and the water side of Eq (4), from ln m_w = ln m_max - ln(1 + a exp(-b (open - c)))/a */
INLINE void deliver(block *b) {
    EACH_LANE b->scratch[j] = exp_(VALVE_B * VALVE_C - VALVE_B * (b->alpha[j] * b->q[j]));
    EACH_LANE b->scratch[j] = LOG_M_MAX - log_(1.0 + VALVE_A * b->scratch[j]) / VALVE_A;
    EACH_LANE {
        b->flow[j] = CP_W / C_W * exp_(b->scratch[j]);
        b->scratch[j] = exp_(BETA2 * b->scratch[j]);
    }
    EACH_LANE {
        b->to_water[j] = (1.0 - exp_(-BETA1 * b->scratch[j])) * b->flow[j];
        b->from_metal[j] = C_W / C_C * b->to_water[j];
        b->half_w[j] = 1.0 / (2.0 + b->flow[j]);
    }
}

/* Converged march, before the controller: the air passes the metal of now, from its entrance on */
INLINE void pass_air(block *b, double m_a, double eps_a, double eps_star, double m_a_counted, const int *damp) {
    double dry = m_a * CP_A / C_C, wet = m_a * CP_AIR / C_C;
    for (int i = N - 1; i >= 0; i--) {
        if (damp[i]) {
            EACH_LANE b->omega_s[j] = saturation_omega(b->T_c[i][j]);
            EACH_LANE {
                double T_in = b->T_a[i + 1][j], omega_in = b->omega[i + 1][j], T_c = b->T_c[i][j];
                double omega_s = b->omega_s[j], dT = T_in - T_c, latent_in = omega_in * latent(T_in);
                double cooled = eps_a * dT, dried = eps_star * (latent_in + dT - omega_s * latent(T_c));
                int is_wet = omega_in > omega_s;
                double T_out = T_in - cooled, omega_out = (latent_in + cooled - dried) / latent(T_out);
                omega_out = is_wet ? min(omega_out, omega_in) : omega_in;
                b->heat[i][j] = is_wet ? wet * dried : dry * cooled;
                b->T_a[i][j] = T_out;
                b->omega[i][j] = omega_out;
                b->sum[CONDENSATE][j] += m_a_counted * (omega_in - omega_out);
            }
        } else {
            EACH_LANE {
                double cooled = eps_a * (b->T_a[i + 1][j] - b->T_c[i][j]);
                b->heat[i][j] = dry * cooled;
                b->T_a[i][j] = b->T_a[i + 1][j] - cooled;
                b->omega[i][j] = b->omega[i + 1][j];
            }
        }
    }
}

/* Converged march, after it: the trapezoidal rule along the water, with means over the step; T_dry, damp as in march() */
INLINE void exchange(block *b, double m_a, double eps_a, double T_dry, int *damp) {
    EACH_LANE b->scratch[j] = 1.0 / (2.0 + (b->from_metal[j] + m_a * CP_A / C_C * eps_a));
    for (int i = 0; i < N; i++) {
        uint64_t next = 0;
        EACH_LANE {
            double T_c = b->T_c[i][j], T_w = b->T_w[i][j], T_w_in = b->T_w_in[j];
            double metal = T_c + b->scratch[j] * (b->heat[i][j] - b->from_metal[j] * (T_c - T_w_in));
            double water = T_w + b->half_w[j] * (b->flow[j] * (T_w_in - T_w) + b->to_water[j] * (metal - T_w_in));
            double T_next = metal + (metal - T_c);
            next |= T_next < T_dry;
            b->T_c[i][j] = T_next;
            b->T_w[i][j] = water + (water - T_w);
            b->T_w_in[j] = water;
        }
        damp[i] = next != 0;
    }
}

/* Printed march: Eq (3), from the water's entrance: the air that enters volume i is still the state [t] of volume i + 1.
m_a_counted: m_a, or 0 where condensate does not count.  damp: whether air may condense in a volume, of this step and, with
T_dry, the metal temperature from which up none does, of the next. */
INLINE void march(block *b, double m_a, double eps_a, double eps_star, double m_a_counted, double T_dry, int *damp) {
    double dry = m_a * CP_A / C_C, wet = m_a * CP_AIR / C_C;
    for (int i = 0; i < N; i++) {
        uint64_t next = 0;
        if (damp[i]) {
            EACH_LANE b->omega_s[j] = saturation_omega(b->T_c[i][j]);
            EACH_LANE {
                double T_in = b->T_a[i + 1][j], omega_in = b->omega[i + 1][j];
                double T_c = b->T_c[i][j], T_w = b->T_w[i][j], T_w_in = b->T_w_in[j], omega_s = b->omega_s[j];
                int is_wet = omega_in > omega_s;
                double dT = T_in - T_c, dT_w = T_c - T_w_in;
                double latent_in = omega_in * latent(T_in), d_eta = latent_in + dT - omega_s * latent(T_c);
                double cooled = eps_a * dT, dried = eps_star * d_eta;

                double heat = is_wet ? wet * dried : dry * cooled;
                double T_next = (T_c - b->from_metal[j] * dT_w) + heat;
                next |= T_next < T_dry;
                b->T_c[i][j] = T_next;
                b->T_w[i][j] = T_w + b->flow[j] * (T_w_in - T_w) + b->to_water[j] * dT_w;
                b->T_w_in[j] = T_w;

                double T_out = T_in - cooled, omega_out = (latent_in + cooled - dried) / latent(T_out);
                omega_out = is_wet ? min(omega_out, omega_in) : omega_in;
                b->T_a[i][j] = T_out;
                b->omega[i][j] = omega_out;
                b->sum[CONDENSATE][j] += m_a_counted * (omega_in - omega_out);
            }
        } else {
            EACH_LANE {
                double T_in = b->T_a[i + 1][j], T_c = b->T_c[i][j], T_w = b->T_w[i][j], T_w_in = b->T_w_in[j];
                double cooled = eps_a * (T_in - T_c), dT_w = T_c - T_w_in;
                double T_next = (T_c - b->from_metal[j] * dT_w) + dry * cooled;
                next |= T_next < T_dry;
                b->T_c[i][j] = T_next;
                b->T_w[i][j] = T_w + b->flow[j] * (T_w_in - T_w) + b->to_water[j] * dT_w;
                b->T_w_in[j] = T_w;
                b->T_a[i][j] = T_in - cooled;
                b->omega[i][j] = b->omega[i + 1][j];
            }
        }
        damp[i] = next != 0;
    }
}

/* a counted second; T_moved: how far the set-point has moved since the settled window began */
INLINE void account(block *b, double T_set, double T_w_in, double m_a, double T_moved, int settled, int in_peak_block) {
    EACH_LANE {
        double T = b->T_a[0][j], e = T - T_set, power = b->flow[j] * (b->T_w[N - 1][j] - T_w_in);
        b->sum[E2][j] += e * e;
        b->sum[ABS_E][j] += fabs(e);
        b->sum[OFF][j] += fabs(e) > OFF_ERROR ? 1.0 : 0.0;
        b->sum[BELOW][j] += m_a * min(e, 0.0);
        b->sum[ABOVE][j] += m_a * max(e, 0.0);
        b->sum[FLOW][j] += b->flow[j];
        b->sum[POWER][j] += power;
        if (in_peak_block) b->power_block[j] += power;
        if (settled) {
            b->sum[E2_SETTLED][j] += e * e;
            b->highest[j] = max(T - T_moved, b->highest[j]);
            b->lowest[j] = min(T - T_moved, b->lowest[j]);
        }
    }
}

INLINE void begin_window(block *b) {
    EACH_LANE b->highest[j] = b->lowest[j] = b->T_a[0][j];
}

/* swing and disturbance of a sample, and the products of the regression, as in metrics.watch_swing */
INLINE void watch_swing(block *b, double t, long f, const double *before, const double *now) {
    if (f & SWING_STARTS) {
        before = now;
        EACH_LANE {
            b->signal[0][j] = b->weight[j] = b->direction[j] = 1.0;
            b->d[j] = b->signal[2][j] = b->signal[3][j] = b->extreme[j] = 0.0;
            b->up_at[j] = 1e9; /* not yet */
        }
    }
    double dm_a = now[0] - before[0], dT_a = now[1] - before[1], dW_a = now[2] - before[2];
    double dT_w = now[3] - before[3], dT_set = now[4] - before[4];
    EACH_LANE {
        double T = b->T_a[0][j], weight = b->weight[j], e = T - now[4], cooled = now[1] - T;
        double eps = min(max(cooled / (now[1] - now[3]), 0.0), 1.0), dry = (1.0 - eps) * dT_a + eps * dT_w;
        double wet = WET_SHARE * (dry + (1.0 - eps) * LATENT_K * dW_a);
        int is_wet = now[2] - MASS_RATIO * b->omega[0][j] > LEAST_DRYING;
        b->weight[j] = max(weight / (1.0 + weight), SAMPLE_S / MEAN_S);
        b->e_mean[j] += weight * (e - b->e_mean[j]);
        b->signal[4][j] = e - b->e_mean[j];
        b->d[j] += (is_wet ? wet : dry) + FLOW_SHARE * cooled * dm_a / now[0] - dT_set;
        b->d_mean[j] += weight * (b->d[j] - b->d_mean[j]);
        b->signal[1][j] = b->d[j] - b->d_mean[j];
        b->signal[2][j] += SAMPLE_S / (SAMPLE_S + LAG_S) * (b->signal[1][j] - b->signal[2][j]);
        b->signal[3][j] += SAMPLE_S / (SAMPLE_S + LAG_S) * (b->signal[2][j] - b->signal[3][j]);
    }
    int inside = (f & IN_SWING_BLOCK) != 0;
    EACH_LANE {
        double h = b->signal[4][j], retreat = b->direction[j] * (b->extreme[j] - h);
        int turned = retreat > TURN_K;
        b->extreme[j] = turned | (retreat < 0.0) ? h : b->extreme[j];
        b->direction[j] = turned ? -b->direction[j] : b->direction[j];
        int up = turned & (b->direction[j] > 0.0);
        double period = t - b->up_at[j], last = b->last_period[j], difference = fabs(period - last);
        int whole = up & (period > 0.0) & inside;
        int alike = (difference <= 0.2 * max(period, last)) | (difference <= b->sample_time[j] + SAMPLE_S);
        b->sum[PERIODS][j] += whole ? 1.0 : 0.0;
        b->sum[SUM_PERIODS][j] += whole ? period : 0.0;
        b->sum[ALIKE][j] += whole & alike ? 1.0 : 0.0;
        b->last_period[j] = whole ? period : last;
        b->up_at[j] = up ? t : b->up_at[j];
    }
    if (!inside) return;
    for (int k = 0; k < 5; k++)
        for (int i = 0; i < 5; i++) EACH_LANE b->product[5 * k + i][j] += b->signal[k][j] * b->signal[i][j];
    EACH_LANE {
        b->product[25][j] = max(b->product[25][j], b->signal[4][j]);
        b->product[26][j] = min(b->product[26][j], b->signal[4][j]);
    }
}

INLINE void begin_swing_block(block *b) {
    memset(b->product, 0, sizeof b->product);
    EACH_LANE {
        b->product[25][j] = -1e300;
        b->product[26][j] = 1e300;
    }
}

static void run_block(const scenarios *s, long k, long n, const day *d, double *sums, double *swings) {
    block store __attribute__((aligned(64))), *b = &store;
    memset(b, 0, sizeof *b);
    long period = 0;
    int together = 1, damp[N];
    for (int i = 0; i < N; i++) damp[i] = 1;
    EACH_LANE {
        b->kp[j] = s->kp[k + j];
        b->ki[j] = s->kp[k + j] * s->sample_time[k + j] / s->ti[k + j];
        b->sample_time[j] = s->sample_time[k + j];
        b->x_bl[j] = s->backlash[k + j];
        b->alpha[j] = 1.0 / (1.0 - s->backlash[k + j]);
        b->x_hat[j] = s->estimate[k + j];
        b->mode[j] = -1.0;
        b->last_period[j] = 1e9; /* none */
        for (int i = 0; i < N; i++) {
            b->T_w[i][j] = b->T_c[i][j] = b->T_a[i][j] = T_INITIAL;
            b->omega[i][j] = d->W_a_in[0] / MASS_RATIO;
        }
        together &= s->sample_time[k + j] == s->sample_time[k];
        long rest = (long)s->sample_time[k + j];
        while (rest) { /* greatest common divisor */
            long r = period % rest;
            period = rest;
            rest = r;
        }
    }
    double T_set_from = 0.0, inputs[2][5] = {{0.0}};
    begin_swing_block(b);
    for (long t = 0, next = 0; t < d->n_steps; t++) {
        double T_set = d->T_set[t], T_w_in = d->T_w_in[t], m_a = d->m_a[t];
        int64_t f = d->flags[t];
        double m_a_counted = f & IS_COUNTED ? m_a : 0.0;
        EACH_LANE {
            b->T_a[N][j] = d->T_a_in[t];
            b->omega[N][j] = d->W_a_in[t] / MASS_RATIO;
            b->T_w_in[j] = T_w_in;
        }
        if (CONVERGED) pass_air(b, m_a, d->eps_a[t], d->eps_star[t], m_a_counted, damp);
        if (t == next) {
            next += period;
            double counts = f & IN_SWITCH_BLOCK ? 1.0 : 0.0;
            int counted = (f & IS_COUNTED) != 0;
            uint64_t moved = together ? control(b, t, T_set, counts, counted, 1) : control(b, t, T_set, counts, counted, 0);
            if (moved || t == 0) deliver(b);
        }
        if (f & WINDOW_STARTS) {
            begin_window(b);
            T_set_from = T_set;
        }
        double T_moved = T_set - T_set_from;
        int64_t kind = f & (IS_COUNTED | IS_SETTLED | IN_PEAK_BLOCK);
        if (kind == IS_COUNTED) account(b, T_set, T_w_in, m_a, T_moved, 0, 0);
        if (kind == (IS_COUNTED | IS_SETTLED)) account(b, T_set, T_w_in, m_a, T_moved, 1, 0);
        if (kind == (IS_COUNTED | IN_PEAK_BLOCK)) account(b, T_set, T_w_in, m_a, T_moved, 0, 1);
        if (kind == (IS_COUNTED | IS_SETTLED | IN_PEAK_BLOCK)) account(b, T_set, T_w_in, m_a, T_moved, 1, 1);
        if (f & IS_SWING_SAMPLE) {
            memcpy(inputs[0], inputs[1], sizeof inputs[0]);
            memcpy(inputs[1], (double[]){m_a, d->T_a_in[t], d->W_a_in[t], T_w_in, T_set}, sizeof inputs[1]);
            watch_swing(b, t, f, inputs[0], inputs[1]);
        }
        if (f & SWING_BLOCK_ENDS) {
            for (int i = 0; i < 27; i++) memcpy(swings + i * n + k, b->product[i], sizeof b->product[i]);
            swings += 27 * n;
            begin_swing_block(b);
        }
        if (f & WINDOW_ENDS) EACH_LANE b->sum[SWING][j] += b->highest[j] - b->lowest[j];
        if (f & PEAK_BLOCK_ENDS) EACH_LANE {
            b->sum[PEAK_POWER][j] = max(b->power_block[j], b->sum[PEAK_POWER][j]);
            b->power_block[j] = 0.0;
        }
        if (CONVERGED) exchange(b, m_a, d->eps_a[t], d->T_dry[t], damp);
        else march(b, m_a, d->eps_a[t], d->eps_star[t], m_a_counted, d->T_dry[t], damp);
    }
    for (int i = 0; i < N_SUMS; i++) memcpy(sums + i * n + k, b->sum[i], sizeof b->sum[i]);
}

/* Before the blocks, for every second: effectiveness of the air side, and T_dry, a temperature up to 1/16 K above the dew
point of the dampest air of the next second, which has entered in the last N + 1.
n: a multiple of LANES, best sorted by sample time.  scratch: 3 n_steps.  sums: out, (N_SUMS, n).  swings: out, (n_swing_blocks, 27, n). */
void coil_loop(scenarios s, long n, day d, double *scratch, double *sums, double *swings) {
    double *eps_a = scratch, *eps_star = scratch + d.n_steps, *T_dry = scratch + 2 * d.n_steps, T = 15.0;
    for (long t = 0; t < d.n_steps; t++) {
        eps_a[t] = effectiveness(BETA3, BETA4, log_(d.m_a[t]));
        eps_star[t] = effectiveness(BETA5, BETA6, log_(d.m_a[t]));
        double omega = 0.0;
        for (long i = t + 1 < N ? 0 : t + 1 - N; i <= t + 1 && i < d.n_steps; i++)
            omega = max(omega, d.W_a_in[i] / MASS_RATIO * 1.000001);
        while (T < 50.0 && saturation_omega(T) < omega) T += 0.0625;
        while (T > 0.0 && saturation_omega(T - 0.0625) >= omega) T -= 0.0625;
        T_dry[t] = T;
    }
    d.eps_a = eps_a;
    d.eps_star = eps_star;
    d.T_dry = T_dry;
    for (long k = 0; k < n; k += LANES) run_block(&s, k, n, &d, sums, swings);
}
