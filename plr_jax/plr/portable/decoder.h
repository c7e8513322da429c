/* A decoder of distance functions that plr_jax writes as compact bytes (plr_jax/plr/portable/compact.py).

   plr_jax_open checks bytes, such as those of a received file, before the first query.
   plr_jax_distance and plr_jax_waypoint answer at a point. Domains far from the origin need points in doubles: for
   them, the functions are plr_jax_distance_far and plr_jax_waypoint_far.

   The decoder allocates nothing and keeps no state. It calls only memcpy, memset and sqrtf. A query never reads beyond
   the end of bytes that plr_jax_open accepts, whatever they hold. Points have at most PLR_JAX_MAX_DIM coordinates.

   Answers equal those of plr.numpy() bit for bit if no operations are fused: compile with -ffp-contract=off. With
   -fno-math-errno, GCC may need no library for sqrtf. */
#ifndef PLR_JAX_DECODER_H
#define PLR_JAX_DECODER_H

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0
#error "floats must be evaluated as floats: on 32-bit x86, compile with -msse2 -mfpmath=sse"
#endif
#if INT_MAX < 2147483647 || DBL_MANT_DIG != 53
#error "this decoder needs ints of 32 bits and doubles of 64 bits"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

#if defined(__GNUC__)
#define PLR_JAX_APART static __attribute__((noinline, unused))
#define PLR_JAX_INLINE static inline __attribute__((always_inline))
#else
#define PLR_JAX_APART static inline
#define PLR_JAX_INLINE static inline
#endif
#ifndef PLR_JAX_MAX_DIM
#define PLR_JAX_MAX_DIM 6
#endif
#define PLR_JAX_MAX_TERMS (PLR_JAX_MAX_DIM < 64 ? 64 : PLR_JAX_MAX_DIM + 1)
#define PLR_JAX_WHOLE 0x800000u   /* number of places along an axis of the domain */
#define PLR_JAX_LEAF 0x80000000u  /* marks the number of a leaf, unlike that of a split */
#define PLR_JAX_NUM_NODES 60u     /* most cells that a query of smooth leaves keeps; it meets 40 on average */

/* A distance function. Its bytes belong to the caller, in flash or in memory. */
struct plr_jax {
    const unsigned char *bytes;
    uint32_t size;
};

/* Results of plr_jax_open. */
enum {
    PLR_JAX_OK = 0,
    PLR_JAX_NO_PLR = 1,    /* not bytes that this decoder reads */
    PLR_JAX_BAD_SIZE = 2,  /* cut off, or with bytes after the end */
    PLR_JAX_DAMAGED = 3,   /* the checksum differs */
    PLR_JAX_TOO_LARGE = 4  /* more coordinates than PLR_JAX_MAX_DIM, or an inconsistent header */
};

/* The 32-bit words at the start. From PLR_JAX_W_FIELDS on, they are positions of parts, in bits. */
enum {
    PLR_JAX_W_MAGIC,
    PLR_JAX_W_SIZE,
    PLR_JAX_W_KIND,   /* a byte each: axes, leaf model, flags, levels of the tree */
    PLR_JAX_W_WIDTHS, /* a byte each: bits of an axis, of fractions of values, of a leaf number, of a position */
    PLR_JAX_W_TERMS,  /* parameters of a leaf */
    PLR_JAX_W_RECORD, /* bytes of a record of the tree */
    PLR_JAX_W_OFFSET,
    PLR_JAX_W_STEP,
    PLR_JAX_W_NUM_PLANES,
    PLR_JAX_W_NUM_ODD,
    PLR_JAX_W_TREE, /* position in bytes */
    PLR_JAX_W_FIELDS,
    PLR_JAX_W_LEVELS, /* without fields to compute from: the bits of the number of a row */
    PLR_JAX_W_PLANES,
    PLR_JAX_W_ODD,
    PLR_JAX_W_ROWS,
    PLR_JAX_W_FOLD,
    PLR_JAX_W_EXACT,
    PLR_JAX_NUM_WORDS
};
enum { PLR_JAX_PLANE, PLR_JAX_CONTINUOUS, PLR_JAX_SMOOTH, PLR_JAX_CONE };
/* Sets of features: 1 << model, PLR_JAX_WRAPS and on. Compilers leave out what a constant set does not have. */
enum { PLR_JAX_WRAPS = 16, PLR_JAX_FOLDS = 32, PLR_JAX_LINES = 64, PLR_JAX_ANY = 127 };
enum { PLR_JAX_FAR = 1, PLR_JAX_FOLDED = 2, PLR_JAX_TURNED = 4, PLR_JAX_CODED = 8, PLR_JAX_VALUES = 16 };
enum { PLR_JAX_STRAIGHT = 32 }; /* no answer is below the cost of a straight line to the nearest goal */
/* The floats of an axis, after the words. */
enum {
    PLR_JAX_LEAST,
    PLR_JAX_MOST,
    PLR_JAX_LO,
    PLR_JAX_SCALE,
    PLR_JAX_START,
    PLR_JAX_TOP,
    PLR_JAX_FIRST,
    PLR_JAX_LAST,
    PLR_JAX_TOLERANCE,
    PLR_JAX_NUM_FLOATS
};
/* The doubles of an axis, for planes and in domains far from the origin. */
enum { PLR_JAX_LEAF_LO, PLR_JAX_LEAF_HI, PLR_JAX_CORNER, PLR_JAX_DOMAIN_LO, PLR_JAX_DOMAIN_HI, PLR_JAX_NUM_DOUBLES };

PLR_JAX_INLINE uint32_t plr_jax_load(const unsigned char *b)
{
    return (uint32_t)b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
}

static inline uint64_t plr_jax_load_long(const unsigned char *b)
{
    return (uint64_t)plr_jax_load(b + 4) << 32 | plr_jax_load(b);
}

static inline uint64_t plr_jax_mask(uint32_t width)
{
    return ((uint64_t)1 << (width & 63u)) - 1u;
}

/* Reads up to 32 bits from a position, the lowest first. Returns 0 beyond the end. Padding and the checksum follow
   the last part, so that a query may read eight bytes at once. */
static inline uint32_t plr_jax_bits(const struct plr_jax *f, uint32_t at, uint32_t width)
{
    if ((at >> 3) + 8u > f->size) {
        return 0;
    }
    return (uint32_t)(plr_jax_load_long(f->bytes + (at >> 3)) >> (at & 7u) & plr_jax_mask(width));
}

static inline int32_t plr_jax_signed(const struct plr_jax *f, uint32_t at, uint32_t width)
{
    const uint32_t sign = 1u << ((width - 1u) & 31u);
    return (int32_t)((plr_jax_bits(f, at, width) ^ sign) - sign);
}

/* If the bytes are constants, so is the word, and compilers leave out code that the bytes do not need. */
PLR_JAX_INLINE uint32_t plr_jax_word(const struct plr_jax *f, uint32_t index)
{
    return plr_jax_load(f->bytes + 4u * index);
}

static inline float plr_jax_float(const struct plr_jax *f, uint32_t at)
{
    const uint32_t bits = plr_jax_bits(f, at, 32);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline float plr_jax_frame(const struct plr_jax *f, uint32_t axis, uint32_t index)
{
    const uint32_t bits = plr_jax_word(f, PLR_JAX_NUM_WORDS + PLR_JAX_NUM_FLOATS * axis + index);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline double plr_jax_double(const struct plr_jax *f, uint32_t at)
{
    const uint64_t bits = (uint64_t)plr_jax_bits(f, at + 32u, 32) << 32 | plr_jax_bits(f, at, 32);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline double plr_jax_exact(const struct plr_jax *f, uint32_t axis, uint32_t index)
{
    return plr_jax_double(f, plr_jax_word(f, PLR_JAX_W_EXACT) + 64u * (PLR_JAX_NUM_DOUBLES * axis + index));
}

static inline uint32_t plr_jax_ones(uint32_t v)
{
    v -= v >> 1 & 0x55555555u;
    v = (v & 0x33333333u) + (v >> 2 & 0x33333333u);
    v = (v + (v >> 4)) & 0x0f0f0f0fu;
    return v * 0x01010101u >> 24;
}

/* Sums the lengths of the fields of 32 marks. Each mark has two bits: 0, 1, 2 and 3 stand for 0, 1, 2 and 4 units. */
static inline uint32_t plr_jax_units(uint64_t v)
{
    const uint64_t threes = 0x3333333333333333u, both = v & v >> 1 & 0x5555555555555555u;
    v = (v & threes) + (v >> 2 & threes) + (both & threes) + (both >> 2 & threes);
    v = (v & 0x0f0f0f0f0f0f0f0fu) + (v >> 4 & 0x0f0f0f0f0f0f0f0fu);
    return (uint32_t)(v * 0x0101010101010101u >> 56);
}

static inline float plr_jax_clamp(float x, float lo, float hi)
{
    return x < lo ? lo : x > hi ? hi : x;
}

/* Moves a coordinate around a periodic axis to between its ends; the upper end becomes the lower one. */
static inline float plr_jax_wrap(float x, float lo, float hi, float scale, float tolerance)
{
    float turns = (x - lo) * scale, moved;
    if (turns < 8388608.0f && turns > -8388608.0f) {
        const float toward_zero = (float)(int32_t)turns;
        turns = toward_zero > turns ? toward_zero - 1.0f : toward_zero;
    }
    moved = plr_jax_clamp(x - turns * (hi - lo), lo, hi);
    return x - hi <= tolerance && x - hi >= -tolerance ? lo : moved;
}

/* Mirrors a point into the part of the domain that is stored. */
static inline void plr_jax_fold(const struct plr_jax *f, float *x, uint32_t dim, uint32_t flags)
{
    uint32_t at = plr_jax_word(f, PLR_JAX_W_FOLD), axis, other, count;
    for (axis = 0; axis < dim; ++axis, at += 64u) {
        x[axis] = x[axis] - plr_jax_float(f, at) - plr_jax_float(f, at + 32u);
    }
    if (flags & PLR_JAX_TURNED) {
        float z[PLR_JAX_MAX_DIM];
        memcpy(z, x, dim * sizeof *x);
        for (axis = 0; axis < dim; ++axis) {
            for (other = 0; other < dim; ++other, at += 32u) {
                const float term = plr_jax_float(f, at) * z[other];
                x[axis] = other ? x[axis] + term : term;
            }
        }
    }
    count = plr_jax_bits(f, at, 8);
    for (at += 8u; count; --count) {
        const uint32_t pivot = plr_jax_bits(f, at, 8);
        const int is_behind = pivot < dim && x[pivot] < 0.0f;
        at += 8u;
        for (axis = 0; axis < dim; ++axis, ++at) {
            if (is_behind && plr_jax_bits(f, at, 1)) {
                x[axis] = -x[axis];
            }
        }
    }
    for (axis = 0; axis < dim; ++axis, at += 64u) {
        x[axis] = plr_jax_clamp(x[axis], plr_jax_float(f, at), plr_jax_float(f, at + 32u));
    }
}

/* Computes the corner values of one half of a cell, from those of the whole cell (ends). The split halves some edges.
   In the middle of each, the value is the mean of the ends, or this plus a stored number, or the mean rounded to
   steps plus a stored number of steps. */
static inline void plr_jax_halve(const struct plr_jax *f, const int32_t *ends, int32_t *corner, uint32_t size,
                                 uint32_t across, int is_upper, const unsigned char *marks, uint32_t next, uint32_t at,
                                 uint32_t width)
{
    const uint32_t fraction = plr_jax_word(f, PLR_JAX_W_WIDTHS) >> 8 & 31u;
    uint32_t i;
    for (i = 0; i < next; i += 64u) {
        const uint64_t here = next - i < 64u ? plr_jax_mask(next - i) : ~(uint64_t)0;
        at += width * plr_jax_units(plr_jax_load_long(marks + (i >> 3)) & here);
    }
    for (i = 0; i < size; i = ((i | across) + 1u) & ~across) {
        const uint32_t mark = (uint32_t)marks[next >> 3] >> (next & 7u) & 3u;
        const int32_t a = ends[i], b = ends[i | across];
        int32_t middle = (a & b) + ((a ^ b) >> 1); /* rounded down */
        next += 2u;
        if (mark) {
            const uint32_t is_wide = mark >> 1, is_double = is_wide & mark, size_of = width << is_wide;
            const int32_t more = plr_jax_signed(f, at + (is_upper ? size_of * is_double : 0u), size_of);
            const uint32_t shift = is_wide & (uint32_t)more ? 0u : fraction;
            middle = (int32_t)((uint32_t)middle + ((1u << shift) >> 1)) >> shift;
            middle = (int32_t)(((uint32_t)middle + (uint32_t)(more >> is_wide)) << shift);
            at += size_of << is_double;
        }
        corner[i] = is_upper ? middle : a;
        corner[i | across] = is_upper ? b : middle;
    }
}

/* Goes from a split to that half of its cell which has the place, and returns the axis of the split. The number of
   the split becomes that of the half: another split, or a leaf, with PLR_JAX_LEAF. A cell is, per axis, its first
   place and its number of places, a power of two. The results may replace the arguments. */
static inline uint32_t plr_jax_step(const struct plr_jax *f, const uint32_t *place, uint32_t *number,
                                    const uint32_t (*from)[2], uint32_t (*cell)[2], const int32_t *ends,
                                    int32_t *corner)
{
    const uint32_t kind = plr_jax_word(f, PLR_JAX_W_KIND), dim = kind & 255u, size = 1u << (dim & 31u);
    const uint32_t widths = plr_jax_word(f, PLR_JAX_W_WIDTHS), axis_bits = widths & 255u;
    const uint32_t leaf_bits = widths >> 16 & 255u, slot = *number & 15u;
    const uint32_t has_values = kind >> 16 & PLR_JAX_VALUES, marks = has_values ? 2u * size : 0u;
    const uint32_t at = plr_jax_word(f, PLR_JAX_W_TREE) + plr_jax_word(f, PLR_JAX_W_RECORD) * (*number >> 4);
    const unsigned char *b;
    uint64_t head;
    uint32_t axis, child, before, are_split, i;
    for (i = 0; i < dim; ++i) {
        cell[i][0] = from[i][0];
        cell[i][1] = from[i][1];
    }
    axis = plr_jax_bits(f, 8u * (at + marks + 4u) + axis_bits * slot, axis_bits);
    if (at > f->size || marks + 12u + 2u * axis_bits > f->size - at || axis >= dim || cell[axis][1] == 1u) {
        for (i = 0; has_values && i < size; ++i) { /* damaged bytes: the whole cell is a leaf */
            corner[i] = ends[i];
        }
        *number = PLR_JAX_LEAF;
        return 0;
    }
    b = f->bytes + at;
    cell[axis][1] >>= 1;
    child = 2u * slot + !!(place[axis] & cell[axis][1]);
    cell[axis][0] |= place[axis] & cell[axis][1];
    are_split = plr_jax_load(b + marks);
    head = plr_jax_load_long(b + marks + 4u + 2u * axis_bits);
    before = (uint32_t)(head & plr_jax_mask(leaf_bits));
    head >>= leaf_bits & 63u;
    if (has_values) {
        plr_jax_halve(f, ends, corner, size, size >> (axis + 1u), child & 1u, b, slot << dim,
                      plr_jax_word(f, PLR_JAX_W_FIELDS) + (uint32_t)(head >> 5 & plr_jax_mask(widths >> 24)),
                      (uint32_t)head & 31u);
    }
    before += plr_jax_ones(are_split & ((1u << child) - 1u));
    *number = are_split >> child & 1u ? before + 1u : (2u * (*number & ~15u) + child - before) | PLR_JAX_LEAF;
    return axis;
}

/* Returns the number of the root, and its cell and corner values. */
static inline uint32_t plr_jax_root(const struct plr_jax *f, uint32_t (*cell)[2], int32_t *corner)
{
    const uint32_t kind = plr_jax_word(f, PLR_JAX_W_KIND), dim = kind & 255u;
    uint32_t i;
    for (i = 0; i < dim; ++i) {
        cell[i][0] = 0;
        cell[i][1] = PLR_JAX_WHOLE;
    }
    for (i = 0; kind >> 16 & PLR_JAX_VALUES && i < 1u << dim; ++i) {
        corner[i] = plr_jax_signed(f, 8u * plr_jax_word(f, PLR_JAX_W_TREE) - (32u << dim) + 32u * i, 32);
    }
    return kind >> 24 > 1u ? 0u : PLR_JAX_LEAF;
}

/* A cell in the plane: its number, its place, the values at its corners, the index of the cell of which it is a half,
   the axis of its split, and the indices of its halves, 0 until a query meets them. */
struct plr_jax_node {
    uint32_t number, cell[2][2];
    int32_t corner[4];
    unsigned char whole, axis, half[2];
};

/* The cells that a query has met, the root first. If there is room for no more, each new cell replaces the last. */
struct plr_jax_nodes {
    uint32_t count, last;
    struct plr_jax_node at[PLR_JAX_NUM_NODES];
};

/* Finds the leaf at a place: up from the last leaf to a cell with the place, then down. */
static inline const struct plr_jax_node *plr_jax_go(const struct plr_jax *f, struct plr_jax_nodes *nodes,
                                                    const uint32_t *place)
{
    uint32_t here = nodes->last;
    struct plr_jax_node *node = nodes->at + here;
    while (place[0] - node->cell[0][0] >= node->cell[0][1]
           || place[1] - node->cell[1][0] >= node->cell[1][1]) {
        here = node->whole;
        node = nodes->at + here;
    }
    while (!(node->number & PLR_JAX_LEAF)) {
        uint32_t next = node->half[place[node->axis] & node->cell[node->axis][1] >> 1 ? 1 : 0];
        if (!next) {
            struct plr_jax_node *const half = nodes->at + nodes->count;
            uint32_t axis;
            next = nodes->count;
            half->number = node->number;
            axis = plr_jax_step(f, place, &half->number, (const uint32_t(*)[2])node->cell, half->cell, node->corner,
                                half->corner);
            if (next < PLR_JAX_NUM_NODES - 1u) {
                node->axis = (unsigned char)axis;
                node->half[half->cell[axis][0] & half->cell[axis][1] ? 1 : 0] = (unsigned char)next;
                ++nodes->count;
            }
            half->whole = (unsigned char)(here == next ? half->whole : here);
            half->axis = half->half[0] = half->half[1] = 0;
        }
        here = next;
        node = nodes->at + here;
    }
    nodes->last = here;
    return node;
}

/* Turns values and derivatives at both ends of [0, 1] into the coefficients of a cubic. */
static inline void plr_jax_cubic(double *p, uint32_t stride)
{
    const double v0 = p[0], d0 = p[stride], v1 = p[2u * stride], d1 = p[3u * stride];
    p[2u * stride] = 3.0 * (v1 - v0) - 2.0 * d0 - d1;
    p[3u * stride] = 2.0 * (v0 - v1) + d0 + d1;
}

/* Returns how many cells of a size the domain has along an axis. */
static inline double plr_jax_count(uint32_t size)
{
    return (double)PLR_JAX_WHOLE / (double)size;
}

/* Computes value and derivatives of smooth leaves at a corner: the value itself, the derivatives by the second and by
   the first coordinate, and the mixed one, all by fractions of the domain. A derivative is a mean over the leaves
   around the corner that have the same value there. If the corner is inside an edge of one of them, its cubic along
   this edge gives all numbers; the cubic follows from the ends of the edge. */
static inline void plr_jax_smooth(const struct plr_jax *f, struct plr_jax_nodes *nodes, const uint32_t *point,
                                  int32_t value, uint32_t edges, double *out)
{
    double weight[4] = {1.0, 0.0, 0.0, 0.0};
    uint32_t quadrant, axis, i;
    out[0] = (double)value;
    out[1] = out[2] = out[3] = 0.0;
    for (quadrant = 0; quadrant < 4u; ++quadrant) {
        const struct plr_jax_node *node;
        uint32_t place[2], from[2], index = 0, edge = 2;
        int is_inside = 1;
        for (axis = 0; axis < 2u; ++axis) {
            place[axis] = point[axis] - (quadrant >> axis & 1u);
            is_inside &= !(place[axis] >> 23)
                         || plr_jax_frame(f, axis, PLR_JAX_LAST) > plr_jax_frame(f, axis, PLR_JAX_FIRST);
            place[axis] &= 0x7fffffu;
        }
        if (!is_inside) {
            continue;
        }
        node = plr_jax_go(f, nodes, place);
        for (axis = 0; axis < 2u; ++axis) {
            const uint32_t size = node->cell[axis][1];
            from[axis] = place[axis] - node->cell[axis][0] + (quadrant >> axis & 1u);
            index |= from[axis] == size ? 2u >> axis : 0u;
            edge = from[axis] && from[axis] < size ? axis : edge;
        }
        if (edge < 2u) {
            const uint32_t across = 2u >> edge, along = node->cell[edge][1];
            const int32_t ends[2] = {node->corner[index], node->corner[index | across]};
            const double scale = plr_jax_count(along), t = (double)from[edge] / (double)along;
            uint32_t end[2];
            double p[2][4], q[4];
            if ((int64_t)ends[0] * (along - from[edge]) + (int64_t)ends[1] * from[edge] != (int64_t)value * along
                || !edges) {
                continue;
            }
            end[edge] = node->cell[edge][0];
            end[1u - edge] = point[1u - edge];
            for (i = 0; i < 2u; ++i, end[edge] += along) {
                plr_jax_smooth(f, nodes, end, ends[i], edges - 1u, p[i]);
            }
            for (i = 0; i < 4u; ++i) {
                if (!(i & across)) {
                    q[0] = p[0][i];
                    q[1] = p[0][i | across] / scale;
                    q[2] = p[1][i];
                    q[3] = p[1][i | across] / scale;
                    plr_jax_cubic(q, 1);
                    out[i] = ((q[3] * t + q[2]) * t + q[1]) * t + q[0];
                    out[i | across] = ((3.0 * q[3] * t + 2.0 * q[2]) * t + q[1]) * scale;
                }
            }
            return;
        }
        if (node->corner[index] == value) {
            const int32_t *const c = node->corner;
            const double u = plr_jax_count(node->cell[0][1]), v = plr_jax_count(node->cell[1][1]);
            weight[1] += v;
            weight[2] += u;
            weight[3] += u * v;
            out[1] += v * v * ((double)c[1u | index] - (double)c[index & 2u]);
            out[2] += u * u * ((double)c[2u | index] - (double)c[index & 1u]);
            out[3] += u * v * (u * v) * (((double)c[3] - (double)c[2]) - ((double)c[1] - (double)c[0]));
        }
    }
    for (i = 1; i < 4u; ++i) {
        out[i] = out[i] / weight[i];
    }
}

/* Searches sorted records; returns the index of the first that begins with the number of the leaf or a larger one. */
static inline uint32_t plr_jax_find(const struct plr_jax *f, uint32_t at, uint32_t count, uint32_t size,
                                    uint32_t leaf)
{
    const uint32_t index_bits = plr_jax_word(f, PLR_JAX_W_WIDTHS) >> 16 & 255u;
    uint32_t first = 0;
    while (first < count) {
        const uint32_t middle = first + ((count - first) >> 1);
        if (plr_jax_bits(f, at + size * middle, index_bits) < leaf) {
            first = middle + 1u;
        } else {
            count = middle;
        }
    }
    return first;
}

/* Computes the coefficients of the smooth leaf at a place; returns its number. Not inline, as this function takes
   more of the stack than all others together. */
PLR_JAX_APART uint32_t plr_jax_smooth_leaf(const struct plr_jax *f, const uint32_t *place, uint32_t (*cell)[2],
                                           float *n)
{
    const double step = (double)plr_jax_float(f, 32u * PLR_JAX_W_STEP);
    uint32_t i, axis, point[2];
    double p[16], q[4], *to;
    struct plr_jax_nodes nodes;
    struct plr_jax_node leaf;
    nodes.count = 1;
    nodes.last = 0;
    memset(nodes.at, 0, sizeof *nodes.at);
    nodes.at[0].number = plr_jax_root(f, nodes.at[0].cell, nodes.at[0].corner);
    leaf = *plr_jax_go(f, &nodes, place);
    memcpy(cell, leaf.cell, sizeof leaf.cell);
    for (i = 0; i < 4u; ++i) {
        for (axis = 0; axis < 2u; ++axis) {
            point[axis] = cell[axis][0] + (i >> (1u - axis) & 1u) * cell[axis][1];
        }
        plr_jax_smooth(f, &nodes, point, leaf.corner[i], 8, q);
        to = p + 4u * (i & 2u) + (2u * i & 2u);
        to[0] = q[0];
        to[1] = q[1] / plr_jax_count(cell[1][1]);
        to[4] = q[2] / plr_jax_count(cell[0][1]);
        to[5] = q[3] / (plr_jax_count(cell[0][1]) * plr_jax_count(cell[1][1]));
    }
    for (i = 0; i < 4u; ++i) {
        plr_jax_cubic(p + 4u * i, 1);
    }
    for (i = 0; i < 4u; ++i) {
        plr_jax_cubic(p + i, 4);
    }
    for (i = 0; i < 16u; ++i) {
        n[i] = (float)((i ? 0.0 : (double)plr_jax_float(f, 32u * PLR_JAX_W_OFFSET)) + step * p[i]);
    }
    return leaf.number;
}

/* Finds the cell and the parameters of the leaf at a point. Turns the point, given relative to the lower corner of a
   far domain, into offsets from the corner of the stored part. Returns 0 for points outside. */
static inline int plr_jax_leaf(const struct plr_jax *f, float *x, uint32_t (*cell)[2], float *n, uint32_t models)
{
    const uint32_t kind = plr_jax_word(f, PLR_JAX_W_KIND), dim = kind & 255u, model = kind >> 8 & 255u;
    const uint32_t flags = kind >> 16 & 255u, terms = plr_jax_word(f, PLR_JAX_W_TERMS);
    const uint32_t leaf_bits = plr_jax_word(f, PLR_JAX_W_WIDTHS) >> 16 & 255u;
    const float step = plr_jax_float(f, 32u * PLR_JAX_W_STEP);
    const double offset = (double)plr_jax_float(f, 32u * PLR_JAX_W_OFFSET);
    uint32_t place[PLR_JAX_MAX_DIM], axis, i, leaf, level = 0, size, count, row, at, width;
    int32_t corner[64];
    int is_smooth;

    /* 1. Place. */
    for (axis = 0; axis < dim; ++axis) {
        if (!(x[axis] >= plr_jax_frame(f, axis, PLR_JAX_LEAST) && x[axis] <= plr_jax_frame(f, axis, PLR_JAX_MOST))) {
            return 0;
        }
    }
    if (models & PLR_JAX_FOLDS && flags & PLR_JAX_FOLDED) {
        plr_jax_fold(f, x, dim, flags);
    }
    for (axis = 0; axis < dim; ++axis) {
        const float lo = plr_jax_frame(f, axis, PLR_JAX_FIRST), hi = plr_jax_frame(f, axis, PLR_JAX_LAST);
        const float scale = plr_jax_frame(f, axis, PLR_JAX_SCALE), top = plr_jax_frame(f, axis, PLR_JAX_TOP);
        float share;
        if (models & PLR_JAX_WRAPS && hi > lo) {
            x[axis] = plr_jax_wrap(x[axis], lo, hi, scale, plr_jax_frame(f, axis, PLR_JAX_TOLERANCE));
        }
        x[axis] = x[axis] - plr_jax_frame(f, axis, PLR_JAX_LO);
        share = x[axis] * scale;
        share = (share < top ? share : top) + plr_jax_frame(f, axis, PLR_JAX_START);
        share = share < 1.0f ? 1.0f : share;
        memcpy(&place[axis], &share, sizeof share);
        place[axis] &= 0x7fffffu; /* the mantissa is the position along the axis */
    }
    is_smooth = models & 1u << PLR_JAX_SMOOTH && flags & PLR_JAX_VALUES && terms == 16u && dim == 2u;
    if (is_smooth) {
        leaf = plr_jax_smooth_leaf(f, place, cell, n);
    } else {
        for (leaf = plr_jax_root(f, cell, corner); !(leaf & PLR_JAX_LEAF); ++level) {
            plr_jax_step(f, place, &leaf, (const uint32_t(*)[2])cell, cell, corner, corner);
        }
    }
    leaf &= ~PLR_JAX_LEAF;

    /* 2. Numbers that are stored as floats. */
    if (!(flags & PLR_JAX_CODED)) {
        width = plr_jax_word(f, PLR_JAX_W_LEVELS);
        row = plr_jax_bits(f, plr_jax_word(f, PLR_JAX_W_FIELDS) + width * leaf, width);
        at = plr_jax_word(f, PLR_JAX_W_ROWS) + 32u * terms * row;
        for (i = 0; i < terms; ++i) {
            n[i] = plr_jax_float(f, at + 32u * i);
        }
        return 1;
    }

    /* 3. Coefficients of the products of coordinates, from corner values. */
    if (models & 1u << PLR_JAX_CONTINUOUS && !is_smooth && flags & PLR_JAX_VALUES) {
        for (width = 1u; width < terms; width *= 2u) {
            for (i = 0; i < terms; ++i) {
                if (i & width) {
                    corner[i] = (int32_t)((uint32_t)corner[i] - (uint32_t)corner[i - width]);
                }
            }
        }
        for (i = 0; i < terms; ++i) {
            n[i] = step * (float)corner[i];
        }
        n[0] = (float)(offset + (double)step * (double)corner[0]);
    } else if (models & 1u << PLR_JAX_PLANE && !is_smooth) {
        /* 4. Or: value at the corner of the domain and slopes, from the value at the center and the rise along axes.
           */
        double center, sum = 0.0;
        const uint32_t at_level = plr_jax_word(f, PLR_JAX_W_LEVELS) + level * (40u + 8u * dim);
        for (axis = 0, size = 0; axis <= dim; ++axis) {
            size += plr_jax_bits(f, at_level + 32u + 8u * axis, 8);
        }
        at = plr_jax_bits(f, at_level, 32) + size * leaf;
        width = plr_jax_bits(f, at_level + 32u, 8);
        center = offset + (double)step * (double)plr_jax_bits(f, at, width);
        for (axis = 0; axis < dim; ++axis) {
            const double lo = plr_jax_exact(f, axis, PLR_JAX_LEAF_LO), hi = plr_jax_exact(f, axis, PLR_JAX_LEAF_HI);
            const double part = 1.0 / (double)PLR_JAX_WHOLE, to = (double)(cell[axis][0] + cell[axis][1]) * part;
            const double l = lo + (hi - lo) * ((double)cell[axis][0] * part);
            const double h = to < 1.0 ? lo + (hi - lo) * to : hi;
            double slope;
            at += width;
            width = plr_jax_bits(f, at_level + 40u + 8u * axis, 8);
            slope = (double)step * (double)plr_jax_signed(f, at, width) * 2.0 / (h - l);
            n[1u + axis] = (float)slope;
            slope = slope * ((l + h) / 2.0 - plr_jax_exact(f, axis, PLR_JAX_CORNER));
            sum = axis ? sum + slope : slope;
        }
        n[0] = (float)(center - sum);
    }

    /* 5. Leaves whose plane is stored as floats. */
    at = plr_jax_word(f, PLR_JAX_W_PLANES);
    count = plr_jax_word(f, PLR_JAX_W_NUM_PLANES);
    size = leaf_bits + 32u * (1u + dim);
    row = plr_jax_find(f, at, count, size, leaf);
    at += size * row;
    if (row < count && plr_jax_bits(f, at, leaf_bits) == leaf) {
        memset(n, 0, terms * sizeof *n);
        n[0] = plr_jax_float(f, at + leaf_bits);
        for (axis = 0; axis < dim; ++axis) {
            i = model % 3u ? 1u << model * (dim - 1u - axis) : 1u + axis;
            n[i] = plr_jax_float(f, at + leaf_bits + 32u * (1u + axis));
        }
    }

    /* 6. Other parameters that steps 3 and 4 do not give, as floats. */
    at = plr_jax_word(f, PLR_JAX_W_ODD);
    count = plr_jax_word(f, PLR_JAX_W_NUM_ODD);
    size = leaf_bits + 40u;
    row = plr_jax_find(f, at, count, size, leaf);
    count = count - row < terms ? count : row + terms; /* damaged bytes may have endless records of a leaf */
    for (at += size * row; row < count && plr_jax_bits(f, at, leaf_bits) == leaf; ++row, at += size) {
        i = plr_jax_bits(f, at + leaf_bits, 8);
        if (i < terms) {
            n[i] = plr_jax_float(f, at + leaf_bits + 8u);
        }
    }
    return 1;
}

/* Returns the least cost of straight lines to the goals, less a margin for rounding. */
static inline float plr_jax_straight(const struct plr_jax *f, const float *x, uint32_t dim)
{
    const uint32_t start = plr_jax_word(f, PLR_JAX_W_FOLD), num_goals = plr_jax_bits(f, start, 8);
    const uint32_t num_groups = plr_jax_bits(f, start + 8u, 8), at_groups = start + 48u;
    const uint32_t at_rates = at_groups + 8u * dim, at_goals = at_rates + 32u * num_groups;
    uint32_t goal, group, axis;
    float least = 0.0f;
    for (goal = 0; goal < num_goals; ++goal) {
        float cost = 0.0f;
        for (group = 0; group < num_groups; ++group) {
            float square = 0.0f, part;
            for (axis = 0; axis < dim; ++axis) {
                const float lo = plr_jax_frame(f, axis, PLR_JAX_FIRST), hi = plr_jax_frame(f, axis, PLR_JAX_LAST);
                float change = x[axis] - plr_jax_float(f, at_goals + 32u * (goal * dim + axis));
                if (plr_jax_bits(f, at_groups + 8u * axis, 8) != group) {
                    continue;
                }
                if (hi > lo) { /* the short way around */
                    change = change < 0.0f ? -change : change;
                    change = hi - lo - change < change ? hi - lo - change : change;
                }
                square = square + change * change;
            }
            part = sqrtf(square) * plr_jax_float(f, at_rates + 32u * group);
            cost = cost + part;
        }
        least = goal && !(cost < least) ? least : cost;
    }
    least = least - plr_jax_float(f, start + 16u);
    return least > 0.0f ? least : 0.0f;
}

/* Evaluates a leaf, from the results of plr_jax_leaf. */
static inline float plr_jax_value(const struct plr_jax *f, const float *x, uint32_t (*cell)[2], float *n,
                                  uint32_t models)
{
    const uint32_t kind = plr_jax_word(f, PLR_JAX_W_KIND), dim = kind & 255u, model = kind >> 8 & 255u;
    const uint32_t powers = model == PLR_JAX_SMOOTH ? 4u : 2u;
    uint32_t axis, i, k, count = plr_jax_word(f, PLR_JAX_W_TERMS);
    float sum = 0.0f;
    if (models & 1u << PLR_JAX_CONE && model == PLR_JAX_CONE) {
        for (axis = 0; axis < dim; ++axis) {
            const float d = x[axis] - n[1u + axis];
            sum = axis ? sum + d * d : d * d;
        }
        return n[0] + sqrtf(sum);
    }
    if (models & 1u << PLR_JAX_PLANE && model == PLR_JAX_PLANE) {
        for (sum = n[0], axis = 0; axis < dim; ++axis) {
            sum = sum + n[1u + axis] * x[axis];
        }
        n[0] = sum;
    } else if (models & (1u << PLR_JAX_CONTINUOUS | 1u << PLR_JAX_SMOOTH)) {
        for (axis = dim; axis--;) { /* Horner's rule, the last axis first */
            const float start = plr_jax_frame(f, axis, PLR_JAX_START);
            float t = x[axis] * plr_jax_frame(f, axis, PLR_JAX_SCALE);
            t = start < 1.0f ? t + (start - 1.0f) : t;
            t = t * (float)(PLR_JAX_WHOLE / cell[axis][1]) - (float)(cell[axis][0] / cell[axis][1]);
            count /= powers;
            for (i = 0; i < count; ++i) {
                sum = n[powers * i + powers - 1u];
                for (k = powers - 1u; k--;) {
                    sum = sum * t + n[powers * i + k];
                }
                n[i] = sum;
            }
        }
    }
    if (models & PLR_JAX_LINES && plr_jax_word(f, PLR_JAX_W_KIND) >> 16 & PLR_JAX_STRAIGHT) {
        sum = plr_jax_straight(f, x, dim);
        return sum > n[0] ? sum : n[0];
    }
    return n[0];
}

/* Checks the bytes of a distance function, and makes f refer to them. Returns PLR_JAX_OK, or what is wrong. */
static inline int plr_jax_open(struct plr_jax *f, const unsigned char *bytes, uint32_t size)
{
    uint32_t crc = 0xffffffffu, i, k, kind, dim, model, terms, coding;
    f->bytes = bytes;
    f->size = size;
    if (size < 4u || plr_jax_word(f, PLR_JAX_W_MAGIC) != 0x31434c50u) {
        return PLR_JAX_NO_PLR;
    }
    if (size < 4u * PLR_JAX_NUM_WORDS + 4u || plr_jax_word(f, PLR_JAX_W_SIZE) != size || size >> 29) {
        return PLR_JAX_BAD_SIZE;
    }
    for (i = 0; i < size - 4u; ++i) {
        crc ^= bytes[i];
        for (k = 0; k < 8u; ++k) {
            crc = crc >> 1 ^ (crc & 1u ? 0xedb88320u : 0u);
        }
    }
    for (i = 0; i < 4u; ++i) {
        if (bytes[size - 4u + i] != (~crc >> 8u * i & 255u)) {
            return PLR_JAX_DAMAGED;
        }
    }
    kind = plr_jax_word(f, PLR_JAX_W_KIND);
    dim = kind & 255u;
    model = kind >> 8 & 255u;
    terms = plr_jax_word(f, PLR_JAX_W_TERMS);
    coding = kind >> 16 & (PLR_JAX_CODED | PLR_JAX_VALUES);
    i = model == PLR_JAX_PLANE || model == PLR_JAX_CONE ? 1u + dim : 1u << (model * dim & 31u);
    if (!dim || dim > PLR_JAX_MAX_DIM || model > PLR_JAX_CONE || terms != i || terms > PLR_JAX_MAX_TERMS
        || (model % 3u && dim > 6u)) {
        return PLR_JAX_TOO_LARGE;
    }
    /* Leaves of planes may be coded as integers, polynomials as values; all others are floats. */
    i = model == PLR_JAX_PLANE ? PLR_JAX_CODED : PLR_JAX_CODED | PLR_JAX_VALUES;
    if (coding && (coding != i || model == PLR_JAX_CONE || (model == PLR_JAX_SMOOTH && dim != 2u))) {
        return PLR_JAX_TOO_LARGE;
    }
    return size < 4u * (PLR_JAX_NUM_WORDS + PLR_JAX_NUM_FLOATS * dim) + 4u ? PLR_JAX_BAD_SIZE : PLR_JAX_OK;
}

/* Returns the number of coordinates of a point. */
static inline uint32_t plr_jax_dim(const struct plr_jax *f)
{
    return plr_jax_word(f, PLR_JAX_W_KIND) & 255u;
}

/* Returns the leaf model. */
static inline uint32_t plr_jax_model(const struct plr_jax *f)
{
    return plr_jax_word(f, PLR_JAX_W_KIND) >> 8 & 255u;
}

/* Returns whether the domain is far from the origin, so that points are doubles. */
static inline int plr_jax_is_far(const struct plr_jax *f)
{
    return (int)(plr_jax_word(f, PLR_JAX_W_KIND) >> 16 & PLR_JAX_FAR);
}

/* Returns the distance at a point z, given relative to the lower corner of a far domain. */
static inline float plr_jax_answer(const struct plr_jax *f, float *z, uint32_t models)
{
    const uint32_t dim = plr_jax_dim(f);
    uint32_t cell[PLR_JAX_MAX_DIM][2], axis;
    float n[PLR_JAX_MAX_TERMS];
    if (plr_jax_leaf(f, z, cell, n, models)) {
        return plr_jax_value(f, z, cell, n, models);
    }
    for (axis = 0; axis < dim; ++axis) {
        if (z[axis] != z[axis]) {
            return NAN;
        }
    }
    return INFINITY;
}

/* Returns what plr_jax_distance does, by code for a set of features alone. */
static inline float plr_jax_distance_of(const struct plr_jax *f, const float *x, uint32_t models)
{
    const uint32_t dim = plr_jax_dim(f);
    float z[PLR_JAX_MAX_DIM];
    memcpy(z, x, dim * sizeof *x);
    return plr_jax_answer(f, z, models);
}

/* The distance to the goal; INFINITY outside the closed domain, NAN for NAN. */
static inline float plr_jax_distance(const struct plr_jax *f, const float *x)
{
    return plr_jax_distance_of(f, x, PLR_JAX_ANY);
}

/* For cones: the next waypoint on the way to the goal; NAN outside the domain, and for other leaves. */
static inline void plr_jax_waypoint(const struct plr_jax *f, const float *x, float *waypoint)
{
    const uint32_t dim = plr_jax_dim(f);
    uint32_t cell[PLR_JAX_MAX_DIM][2], axis;
    float z[PLR_JAX_MAX_DIM], n[PLR_JAX_MAX_TERMS];
    int is_inside;
    memcpy(z, x, dim * sizeof *x);
    is_inside = plr_jax_model(f) == PLR_JAX_CONE && plr_jax_leaf(f, z, cell, n, 1u << PLR_JAX_CONE);
    for (axis = 0; axis < dim; ++axis) {
        waypoint[axis] = is_inside ? plr_jax_frame(f, axis, PLR_JAX_LO) + n[1u + axis] : NAN;
    }
}

/* Moves a point around periodic axes in 64 bits, then subtracts the lower corner of the domain. */
static inline void plr_jax_place_far(const struct plr_jax *f, const double *x, float *z, uint32_t dim)
{
    uint32_t axis;
    for (axis = 0; axis < dim; ++axis) {
        const double lo = plr_jax_exact(f, axis, PLR_JAX_DOMAIN_LO), hi = plr_jax_exact(f, axis, PLR_JAX_DOMAIN_HI);
        double moved = x[axis];
        if (plr_jax_frame(f, axis, PLR_JAX_LAST) > plr_jax_frame(f, axis, PLR_JAX_FIRST) && moved - moved == 0.0) {
            double turns = (moved - lo) * (1.0 / (hi - lo));
            if (turns < 4503599627370496.0 && turns > -4503599627370496.0) {
                const double toward_zero = (double)(int64_t)turns;
                turns = toward_zero > turns ? toward_zero - 1.0 : toward_zero;
            }
            moved = moved - turns * (hi - lo);
            moved = moved < lo || x[axis] - hi == 0.0 ? lo : moved > hi ? hi : moved;
        }
        z[axis] = (float)(moved - lo);
    }
}

/* Return what plr_jax_distance_of and plr_jax_distance do, for domains far from the origin. */
static inline float plr_jax_distance_far_of(const struct plr_jax *f, const double *x, uint32_t models)
{
    float z[PLR_JAX_MAX_DIM];
    plr_jax_place_far(f, x, z, plr_jax_dim(f));
    return plr_jax_answer(f, z, models);
}

static inline float plr_jax_distance_far(const struct plr_jax *f, const double *x)
{
    return plr_jax_distance_far_of(f, x, PLR_JAX_ANY);
}

/* Does what plr_jax_waypoint does, for domains far from the origin. */
static inline void plr_jax_waypoint_far(const struct plr_jax *f, const double *x, double *waypoint)
{
    const uint32_t dim = plr_jax_dim(f);
    uint32_t cell[PLR_JAX_MAX_DIM][2], axis;
    float z[PLR_JAX_MAX_DIM], n[PLR_JAX_MAX_TERMS];
    int is_inside;
    plr_jax_place_far(f, x, z, dim);
    is_inside = plr_jax_model(f) == PLR_JAX_CONE && plr_jax_leaf(f, z, cell, n, 1u << PLR_JAX_CONE);
    for (axis = 0; axis < dim; ++axis) {
        waypoint[axis] = is_inside ? plr_jax_exact(f, axis, PLR_JAX_DOMAIN_LO) + (double)n[1u + axis] : (double)NAN;
    }
}

#endif
