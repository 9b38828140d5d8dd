/* DOP853 for an autonomous system of fixed size: Hairer, Norsett and Wanner, Solving Ordinary
   Differential Equations I, second edition, section II.5, method of order 8 with error estimates of
   order 5 and 3; step control and first step of section II.4. No dense output.

   The including file gives N, `system`, and
       static system make_system(const double *parameters);
       static inline void field(const system *s, const real *y, real *rates);
       static inline void restore(real *y);                     what the flow keeps, after each step
       static real violation(const real *y);                    how far y is from that
       static real energy(const system *s, const real *y);
   All loops run over a constant N, so that they are unrolled and vectorised. The time is summed
   with compensation: in 1e6 steps its rounding would cost more digits than the method.

   real: double, or -DREAL="long double" for reference solutions. */
#ifndef DOP853_H
#define DOP853_H

#include <stdint.h>

#include "real.h"

#define EACH for (int i = 0; i < N; i++)

static const real A2_1 = 5.26001519587677318785587544488e-2L;
static const real A3_1 = 1.97250569845378994544595329183e-2L,
    A3_2 = 5.91751709536136983633785987549e-2L;
static const real A4_1 = 2.95875854768068491816892993775e-2L,
    A4_3 = 8.87627564304205475450678981324e-2L;
static const real A5_1 = 2.41365134159266685502369798665e-1L,
    A5_3 = -8.84549479328286085344864962717e-1L, A5_4 = 9.24834003261792003115737966543e-1L;
static const real A6_1 = 3.7037037037037037037037037037e-2L,
    A6_4 = 1.70828608729473871279604482173e-1L, A6_5 = 1.25467687566822425016691814123e-1L;
static const real A7_1 = 3.7109375e-2L, A7_4 = 1.70252211019544039314978060272e-1L,
    A7_5 = 6.02165389804559606850219397283e-2L, A7_6 = -1.7578125e-2L;
static const real A8_1 = 3.70920001185047927108779319836e-2L,
    A8_4 = 1.70383925712239993810214054705e-1L, A8_5 = 1.07262030446373284651809199168e-1L,
    A8_6 = -1.53194377486244017527936158236e-2L, A8_7 = 8.27378916381402288758473766002e-3L;
static const real A9_1 = 6.24110958716075717114429577812e-1L,
    A9_4 = -3.36089262944694129406857109825L, A9_5 = -8.68219346841726006818189891453e-1L,
    A9_6 = 2.75920996994467083049415600797e1L, A9_7 = 2.01540675504778934086186788979e1L,
    A9_8 = -4.34898841810699588477366255144e1L;
static const real A10_1 = 4.77662536438264365890433908527e-1L,
    A10_4 = -2.48811461997166764192642586468L, A10_5 = -5.90290826836842996371446475743e-1L,
    A10_6 = 2.12300514481811942347288949897e1L, A10_7 = 1.52792336328824235832596922938e1L,
    A10_8 = -3.32882109689848629194453265587e1L, A10_9 = -2.03312017085086261358222928593e-2L;
static const real A11_1 = -9.3714243008598732571704021658e-1L,
    A11_4 = 5.18637242884406370830023853209L, A11_5 = 1.09143734899672957818500254654L,
    A11_6 = -8.14978701074692612513997267357L, A11_7 = -1.85200656599969598641566180701e1L,
    A11_8 = 2.27394870993505042818970056734e1L, A11_9 = 2.49360555267965238987089396762L,
    A11_10 = -3.0467644718982195003823669022L;
static const real A12_1 = 2.27331014751653820792359768449L,
    A12_4 = -1.05344954667372501984066689879e1L, A12_5 = -2.00087205822486249909675718444L,
    A12_6 = -1.79589318631187989172765950534e1L, A12_7 = 2.79488845294199600508499808837e1L,
    A12_8 = -2.85899827713502369474065508674L, A12_9 = -8.87285693353062954433549289258L,
    A12_10 = 1.23605671757943030647266201528e1L, A12_11 = 6.43392746015763530355970484046e-1L;
static const real B1 = 5.42937341165687622380535766363e-2L, B6 = 4.45031289275240888144113950566L,
    B7 = 1.89151789931450038304281599044L, B8 = -5.8012039600105847814672114227L,
    B9 = 3.1116436695781989440891606237e-1L, B10 = -1.52160949662516078556178806805e-1L,
    B11 = 2.01365400804030348374776537501e-1L, B12 = 4.47106157277725905176885569043e-2L;
/* fifth order error: difference of two weights */
static const real E1 = 0.1312004499419488073250102996e-1L,
    E6 = -0.1225156446376204440720569753e1L, E7 = -0.4957589496572501915214079952L,
    E8 = 0.1664377182454986536961530415e1L, E9 = -0.3503288487499736816886487290L,
    E10 = 0.3341791187130174790297318841L, E11 = 0.8192320648511571246570742613e-1L,
    E12 = -0.2235530786388629525884427845e-1L;
static const real BHH1 = 0.244094488188976377952755905512L,
    BHH9 = 0.733846688281611857341361741547L, BHH12 = 0.220588235294117647058823529412e-1L;

/* One step; returns the square of the error in units of the tolerance. */
static inline real attempt(const system *s, const real *restrict y, const real *restrict k1, real h,
                           real rtol, real atol, real *restrict end)
{
    real u[N], k2[N], k3[N], k4[N], k5[N], k6[N], k7[N], k8[N], k9[N], k10[N], k11[N], k12[N];
    real five = 0, three = 0;
    EACH u[i] = y[i] + h * (A2_1 * k1[i]);
    field(s, u, k2);
    EACH u[i] = y[i] + h * (A3_1 * k1[i] + A3_2 * k2[i]);
    field(s, u, k3);
    EACH u[i] = y[i] + h * (A4_1 * k1[i] + A4_3 * k3[i]);
    field(s, u, k4);
    EACH u[i] = y[i] + h * (A5_1 * k1[i] + A5_3 * k3[i] + A5_4 * k4[i]);
    field(s, u, k5);
    EACH u[i] = y[i] + h * (A6_1 * k1[i] + A6_4 * k4[i] + A6_5 * k5[i]);
    field(s, u, k6);
    EACH u[i] = y[i] + h * (A7_1 * k1[i] + A7_4 * k4[i] + A7_5 * k5[i] + A7_6 * k6[i]);
    field(s, u, k7);
    EACH u[i] = y[i] + h * (A8_1 * k1[i] + A8_4 * k4[i] + A8_5 * k5[i] + A8_6 * k6[i]
            + A8_7 * k7[i]);
    field(s, u, k8);
    EACH u[i] = y[i] + h * (A9_1 * k1[i] + A9_4 * k4[i] + A9_5 * k5[i] + A9_6 * k6[i]
            + A9_7 * k7[i] + A9_8 * k8[i]);
    field(s, u, k9);
    EACH u[i] = y[i] + h * (A10_1 * k1[i] + A10_4 * k4[i] + A10_5 * k5[i] + A10_6 * k6[i]
            + A10_7 * k7[i] + A10_8 * k8[i] + A10_9 * k9[i]);
    field(s, u, k10);
    EACH u[i] = y[i] + h * (A11_1 * k1[i] + A11_4 * k4[i] + A11_5 * k5[i] + A11_6 * k6[i]
            + A11_7 * k7[i] + A11_8 * k8[i] + A11_9 * k9[i] + A11_10 * k10[i]);
    field(s, u, k11);
    EACH u[i] = y[i] + h * (A12_1 * k1[i] + A12_4 * k4[i] + A12_5 * k5[i] + A12_6 * k6[i]
            + A12_7 * k7[i] + A12_8 * k8[i] + A12_9 * k9[i] + A12_10 * k10[i] + A12_11 * k11[i]);
    field(s, u, k12);
    EACH {
        const real slope = B1 * k1[i] + B6 * k6[i] + B7 * k7[i] + B8 * k8[i] + B9 * k9[i]
                           + B10 * k10[i] + B11 * k11[i] + B12 * k12[i];
        const real fifth = E1 * k1[i] + E6 * k6[i] + E7 * k7[i] + E8 * k8[i] + E9 * k9[i]
                           + E10 * k10[i] + E11 * k11[i] + E12 * k12[i];
        const real third = slope - BHH1 * k1[i] - BHH9 * k9[i] - BHH12 * k12[i];
        end[i] = y[i] + h * slope;
        const real size = fabs(end[i]) > fabs(y[i]) ? fabs(end[i]) : fabs(y[i]);
        const real over = 1 / (atol + rtol * size);
        five += fifth * over * (fifth * over);
        three += third * over * (third * over);
    }
    const real both = five + (real)0.01 * three;
    return both > 0 ? h * h * five * five / (both * N) : 0;
}

/* |v| in units of the tolerance at y, root mean square. */
static real in_tolerances(const real *v, const real *y, real rtol, real atol)
{
    real sum = 0;
    EACH {
        const real ratio = v[i] / (atol + rtol * fabs(y[i]));
        sum += ratio * ratio;
    }
    return sqrt(sum / N);
}

/* 1 / e^(1/8) from e^2. */
static inline real growth(real squared)
{
    return 1 / sqrt(sqrt(sqrt(sqrt(squared + (real)1e-30))));
}

static real first_step(const system *s, const real *y, const real *k1, real rtol, real atol)
{
    real u[N], k2[N], change[N];
    const real d0 = in_tolerances(y, y, rtol, atol), d1 = in_tolerances(k1, y, rtol, atol);
    const real h0 = d0 < 1e-5 || d1 < 1e-5 ? (real)1e-6 : (real)0.01 * d0 / d1;
    EACH u[i] = y[i] + h0 * k1[i];
    field(s, u, k2);
    EACH change[i] = (k2[i] - k1[i]) / h0;
    const real d2 = in_tolerances(change, y, rtol, atol), most = d1 > d2 ? d1 : d2;
    const real h1 = most > 1e-15 ? sqrt(sqrt(sqrt((real)0.01 / most))) : h0 * (real)1e-3;
    return h1 < 100 * h0 ? h1 : 100 * h0;
}

/* From the state to time t_end > 0. counts: accepted steps, attempts.
   watched, unless NULL: largest |E - E0| and largest violation at the ends of steps, both raised
   from what is given; E0 is watched[2].
   Returns 0, or -1 when the step became too small or after 1e4 + 1e3 t_end attempts. */
int64_t solve(const double *parameters, double t_end, double rtol, double atol, real *state,
              int64_t *counts, double *watched)
{
    const system s = make_system(parameters);
    real y[N], end[N], k1[N], t = 0, lost = 0;
    int rejected = 0;
    EACH y[i] = state[i];
    field(&s, y, k1);
    real h = first_step(&s, y, k1, rtol, atol);
    counts[0] = counts[1] = 0;
    for (;;) {
        const real left = (t_end - t) + lost;
        const int last = (real)1.01 * h >= left;
        if (last)
            h = left;
        if (!(h > 0) || t + h == t || counts[1] > 1e4 + 1e3 * t_end)
            return -1;
        const real squared = attempt(&s, y, k1, h, rtol, atol, end);
        real factor = (real)0.9 * growth(squared);
        counts[1]++;
        if (!(squared <= 1)) {
            h *= factor > (real)0.333 ? factor : (real)0.333;
            rejected = 1;
            continue;
        }
        const real rise = h - lost, next = t + rise;
        lost = (next - t) - rise;
        t = next;
        EACH y[i] = end[i];
        restore(y);
        counts[0]++;
        if (watched) {
            const double change = fabs(energy(&s, y) - (real)watched[2]), off = violation(y);
            watched[0] = change > watched[0] ? change : watched[0];
            watched[1] = off > watched[1] ? off : watched[1];
        }
        if (last)
            break;
        factor = factor < (real)0.333 ? (real)0.333 : factor > 6 ? 6 : factor;
        h *= rejected && factor > 1 ? 1 : factor;
        rejected = 0;
        field(&s, y, k1);
    }
    EACH state[i] = y[i];
    return 0;
}

/* Energy and violation of a state. */
void look(const double *parameters, const real *state, double *energy_and_violation)
{
    const system s = make_system(parameters);
    energy_and_violation[0] = energy(&s, state);
    energy_and_violation[1] = violation(state);
}

#endif
