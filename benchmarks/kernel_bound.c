/* The right-hand side of williamson5 by hand, with NP and REAL known: what a compiler makes of the
   same arrays in the same order, for kernel_bound.py to put beside the generated kernels. */
#include <stddef.h>
#include <string.h>

/* A register of the processor; the arrays hold groups of 64 bytes. */
#ifdef __AVX512F__
#define BYTES 64
#else
#define BYTES 32
#endif
typedef REAL V __attribute__((vector_size(BYTES)));
typedef REAL U __attribute__((vector_size(BYTES), aligned(sizeof(REAL))));
#define L ((int)(64 / sizeof(REAL)))
#define H ((int)(BYTES / sizeof(REAL)))
#define S (64 / BYTES)
#define P (NP * NP)

int register_bytes(void) { return BYTES; }

/* Numbers of x at the nodes of a register: the part of a group from its `begin` on. */
static inline V load(const REAL *x, const int *at, int begin) {
  if (at[0] < 0) return *(const U *)(x + ~at[0] + begin);
  V r;
  for (int l = 0; l < H; l++) r[l] = x[at[begin + l]];
  return r;
}

void element(int groups, int whole, size_t n, const int *nodes, const V *basis, const REAL *d,
             const REAL *w, const REAL *g, const REAL *bottom, const REAL *scale,
             const REAL *coriolis, const REAL *x, V *local, REAL *out) {
  V s[NP][NP], f1[NP][NP], f2[NP][NP], c1[NP][NP], c2[NP][NP], us[NP][NP], vs[NP][NP];
  REAL D[NP][NP], W[NP][NP];
  memcpy(D, d, sizeof D);
  memcpy(W, w, sizeof W);
  for (int part = 0; part < groups * S; part++) {
    int e = part / S, q = part % S, h0 = q * H;
    const V *b = basis + (size_t)e * P * 4 * S + q;
    const int *at = nodes + (size_t)e * P * L;
    for (int i = 0; i < NP; i++)
      for (int j = 0; j < NP; j++, b += 4 * S, at += L) {
        V u = load(x, at, h0), v = load(x + n, at, h0), h = load(x + 2 * n, at, h0);
        V fu = h * u, fv = h * v;
        us[i][j] = u;
        vs[i][j] = v;
        s[i][j] = (REAL)0.5 * (u * u + v * v) + *g * (h + load(bottom, at, h0));
        f1[i][j] = fu * b[3 * S] - fv * b[2 * S];
        f2[i][j] = b[0] * fv - b[S] * fu;
        c1[i][j] = b[2 * S] * u + b[3 * S] * v;
        c2[i][j] = b[0] * u + b[S] * v;
      }
    b -= 4 * S * P;
    at -= L * P;
    V *o = local + (size_t)e * P * 3 * S + q;
    for (int i = 0; i < NP; i++)
      for (int j = 0; j < NP; j++, b += 4 * S, at += L, o += 3 * S) {
        V s1 = {0}, s2 = {0}, div = {0}, zeta = {0};
#pragma GCC unroll 16
        for (int m = 0; m < NP; m++) {
          s1 += D[i][m] * s[m][j];
          s2 += D[j][m] * s[i][m];
          div += D[i][m] * f1[m][j] + D[j][m] * f2[i][m];
          zeta += D[i][m] * c1[m][j] - D[j][m] * c2[i][m];
        }
        V ru = W[i][j] * (zeta * vs[i][j] - (s1 * b[3 * S] - s2 * b[S]));
        V rv = W[i][j] * ((b[2 * S] * s1 - b[0] * s2) - zeta * us[i][j]);
        V rh = -W[i][j] * div;
        if (e < whole && i > 0 && i < NP - 1 && j > 0 && j < NP - 1) {
          size_t first = ~at[0] + h0;
          V a = *(const U *)(scale + first), f = *(const U *)(coriolis + first);
          *(U *)(out + first) = a * ru + f * vs[i][j];
          *(U *)(out + n + first) = a * rv - f * us[i][j];
          *(U *)(out + 2 * n + first) = a * rh;
        } else {
          o[0] = ru;
          o[S] = rv;
          o[2 * S] = rh;
        }
      }
  }
}

static inline REAL sum(const REAL *local, const int *at) {
  REAL total = local[at[0]];
  if (at[1] >= 0) {
    total += local[at[1]];
    if (at[2] >= 0) total += local[at[2]] + local[at[3]];
  }
  return total;
}

void dss(int first, size_t n, const int *places, const REAL *scale, const REAL *coriolis,
         const REAL *local, const REAL *x, REAL *out) {
  for (size_t i = first; i < n; i++) {
    REAL a = scale[i], f = coriolis[i];
    const int *at = places + 4 * i;
    out[i] = a * sum(local, at) + f * x[n + i];
    out[n + i] = a * sum(local + L, at) - f * x[i];
    out[2 * n + i] = a * sum(local + 2 * L, at);
  }
}

void stage(size_t n, const REAL *x, const REAL *slope, const REAL *c, REAL *out) {
  for (size_t i = 0; i < n; i++) out[i] = x[i] + *c * slope[i];
}

void copy(size_t bytes, const char *from, char *to) { memcpy(to, from, bytes); }

/* Independent chains of products and sums: the most a core does in registers. */
void arithmetic(size_t rounds, V *out) {
  V r[8], a = out[0], b = out[1];
  for (int k = 0; k < 8; k++) r[k] = out[k];
  for (size_t i = 0; i < rounds; i++)
#pragma GCC unroll 8
    for (int k = 0; k < 8; k++) r[k] = r[k] * a + b;
  for (int k = 0; k < 8; k++) out[k] = r[k];
}
