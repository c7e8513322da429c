/* A decoder of distance functions that plr_jax writes as compact bytes (plr_jax/plr/portable/compact.py).

   plr_jax_open: checks bytes, such as those of a file that was received, before the first query.
   plr_jax_distance, plr_jax_waypoint: answers at a point. For domains far from the origin, whose points are
   doubles, they have the suffix _far.

   The decoder allocates nothing, keeps no state, and calls only memcpy, memset and sqrtf. Bytes that plr_jax_open accepts are
   never read beyond their end, whatever they hold. Points need at most PLR_JAX_MAX_DIM coordinates.

   Answers equal those of plr.numpy() bit for bit if no operations are fused: compile with -ffp-contract=off. */
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
#else
#define PLR_JAX_APART static inline
#endif
#ifndef PLR_JAX_MAX_DIM
#define PLR_JAX_MAX_DIM 6
#endif
#define PLR_JAX_MAX_TERMS (PLR_JAX_MAX_DIM < 64 ? 64 : PLR_JAX_MAX_DIM + 1)
#define PLR_JAX_MAX_LEVELS 61

/* A distance function: its bytes, which stay with the caller, in flash or in memory. */
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

/* The 32-bit words at the start; from PLR_JAX_W_ODD to PLR_JAX_W_EXACT they are positions of parts, in bits. */
enum {
    PLR_JAX_W_MAGIC,
    PLR_JAX_W_SIZE,
    PLR_JAX_W_KIND,   /* a byte each: axes, leaf model, flags, levels of the tree */
    PLR_JAX_W_WIDTHS, /* a byte each: bits of an axis, fraction bits of values, bits of a leaf's number */
    PLR_JAX_W_TERMS,  /* numbers of a leaf */
    PLR_JAX_W_NUM_ODD,
    PLR_JAX_W_NUM_PLANES,
    PLR_JAX_W_OFFSET,
    PLR_JAX_W_STEP,
    PLR_JAX_W_ODD,
    PLR_JAX_W_PLANES,
    PLR_JAX_W_TREE,
    PLR_JAX_W_AXES,
    PLR_JAX_W_LEVELS,
    PLR_JAX_W_MARKS,
    PLR_JAX_W_ROWS,
    PLR_JAX_W_FOLD,
    PLR_JAX_W_EXACT,
    PLR_JAX_NUM_WORDS
};
enum { PLR_JAX_PLANE, PLR_JAX_CONTINUOUS, PLR_JAX_SMOOTH, PLR_JAX_CONE };
enum { PLR_JAX_ANY = 15 }; /* a set of leaf models: the sum of 1 << model */
enum { PLR_JAX_FAR = 1, PLR_JAX_FOLDED = 2, PLR_JAX_TURNED = 4, PLR_JAX_CODED = 8, PLR_JAX_VALUES = 16 };
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

/* Up to 32 bits from a position, the lowest first; 0 beyond the end. The checksum pads the last part. */
static inline uint32_t plr_jax_bits(const struct plr_jax *f, uint32_t at, uint32_t width)
{
    const uint32_t shift = at & 7u;
    const unsigned char *b;
    uint32_t value;
    if ((at >> 3) + 5u > f->size) {
        return 0;
    }
    b = f->bytes + (at >> 3);
    value = ((uint32_t)b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24) >> shift;
    value |= ((uint32_t)b[4] << 24) << (8u - shift);
    return width < 32u ? value & ((1u << width) - 1u) : value;
}

static inline int32_t plr_jax_signed(const struct plr_jax *f, uint32_t at, uint32_t width)
{
    const uint32_t sign = 1u << ((width - 1u) & 31u);
    return width ? (int32_t)((plr_jax_bits(f, at, width) ^ sign) - sign) : 0;
}

static inline uint32_t plr_jax_word(const struct plr_jax *f, uint32_t index)
{
    return plr_jax_bits(f, 32u * index, 32);
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
    return plr_jax_float(f, 32u * (PLR_JAX_NUM_WORDS + PLR_JAX_NUM_FLOATS * axis + index));
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

/* Sums the weights of all digits before one. Bits have weights 0 and 1, pairs of bits 0, 1, 2 and 4. A record of 96
   bits holds the sum before it and 64 bits of digits. */
static inline uint32_t plr_jax_rank(const struct plr_jax *f, uint32_t at, uint32_t bit, uint32_t is_pair)
{
    uint32_t rest = bit & 63u, sum, word, high;
    at += (bit >> 6) * 96u;
    sum = plr_jax_bits(f, at, 32);
    do {
        at += 32u;
        word = plr_jax_bits(f, at, rest < 32u ? rest : 32u);
        high = is_pair ? word >> 1 & 0x55555555u : 0u;
        sum += plr_jax_ones(word) + plr_jax_ones(high) + plr_jax_ones(word & high);
        rest -= 32u;
    } while (rest < 32u);
    return sum;
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

/* Replaces the corner values of a cell by those of one half. In the middle of an edge that the split halves, the value
   is the mean of the ends, plus a stored number, or the mean rounded to steps plus a stored number of steps. */
static inline void plr_jax_halve(const struct plr_jax *f, int32_t *corner, uint32_t dim, uint32_t axis, uint32_t upper,
                                 uint32_t split, uint32_t at_level, uint32_t fraction)
{
    const uint32_t size = 1u << dim, across = size >> (axis + 1u), marks = plr_jax_word(f, PLR_JAX_W_MARKS);
    const uint32_t width = plr_jax_bits(f, at_level + 32u, 8), half = (1u << fraction) >> 1;
    uint32_t digit = split << (dim - 1u), i;
    uint32_t at = plr_jax_bits(f, at_level, 32) + width * plr_jax_rank(f, marks, 2u * digit, 1);
    for (i = 0; i < size; ++i) {
        const int32_t a = corner[i], b = corner[(i | across) & 63u];
        int32_t middle = (a & b) + ((a ^ b) >> 1);
        uint32_t mark, wide;
        if (i & across) {
            continue;
        }
        mark = plr_jax_bits(f, marks + 96u * (digit >> 5) + 32u + 2u * (digit & 31u), 2);
        wide = mark > 1u ? 2u * width : width;
        if (mark) {
            int32_t more = plr_jax_signed(f, at + (mark == 3u && upper ? wide : 0u), wide);
            const uint32_t is_fine = mark > 1u && more & 1;
            more = mark > 1u ? more >> 1 : more;
            if (!is_fine) {
                middle = (int32_t)((uint32_t)middle + half) >> fraction;
            }
            middle = (int32_t)(((uint32_t)middle + (uint32_t)more) << (is_fine ? 0u : fraction));
            at += mark == 3u ? 2u * wide : wide;
        }
        corner[upper ? i : i | across] = middle;
        ++digit;
    }
}

/* The nodes from the root to a leaf in the plane, with the values at their corners. */
struct plr_jax_path {
    uint32_t last; /* index of the leaf; 0 if there is none yet */
    struct {
        uint32_t node, cell[2][2];
        int32_t corner[4];
    } at[PLR_JAX_MAX_LEVELS];
};

/* Finds the leaf at a place: its number, where the fields of its level are, per axis the number of halvings and the
   position of its cell, and the values at its corners if there are some. A path, if one is given, is followed as far as
   it leads to the place, and then leads to this leaf. */
static inline uint32_t plr_jax_descend(const struct plr_jax *f, const uint32_t *place, uint32_t (*cell)[2],
                                       int32_t *corner, uint32_t *at_level, struct plr_jax_path *path)
{
    const uint32_t kind = plr_jax_word(f, PLR_JAX_W_KIND), dim = kind & 255u;
    const uint32_t widths = plr_jax_word(f, PLR_JAX_W_WIDTHS), tree = plr_jax_word(f, PLR_JAX_W_TREE);
    const uint32_t has_values = kind >> 16 & PLR_JAX_VALUES;
    uint32_t level = 0, node = 0, i;
    memset(cell, 0, dim * sizeof *cell);
    for (i = 0; has_values && i < 1u << dim; ++i) {
        corner[i] = plr_jax_signed(f, plr_jax_word(f, PLR_JAX_W_MARKS) - (32u << dim) + 32u * i, 32);
    }
    if (path) {
        for (level = path->last; level; --level) {
            const uint32_t(*const held)[2] = (const uint32_t(*)[2])path->at[level].cell;
            if (place[0] >> (23u - held[0][0]) == held[0][1] && place[1] >> (23u - held[1][0]) == held[1][1]) {
                node = path->at[level].node;
                memcpy(cell, held, sizeof path->at[level].cell);
                memcpy(corner, path->at[level].corner, sizeof path->at[level].corner);
                break;
            }
        }
    }
    for (;; ++level) {
        const uint32_t split = plr_jax_rank(f, tree, node, 0), axis_bits = widths & 255u;
        const uint32_t axis = plr_jax_bits(f, plr_jax_word(f, PLR_JAX_W_AXES) + axis_bits * split, axis_bits);
        uint32_t upper;
        if (path) {
            path->last = level;
            path->at[level].node = node;
            memcpy(path->at[level].cell, cell, sizeof path->at[level].cell);
            memcpy(path->at[level].corner, corner, sizeof path->at[level].corner);
        }
        *at_level = plr_jax_word(f, PLR_JAX_W_LEVELS) + level * (40u + 8u * dim);
        if (!plr_jax_bits(f, tree + (node >> 6) * 96u + 32u + (node & 63u), 1) || level + 1u >= kind >> 24
            || axis >= dim || cell[axis][0] == 23u) {
            return node - split;
        }
        upper = place[axis] >> (22u - cell[axis][0]) & 1u;
        ++cell[axis][0];
        cell[axis][1] = 2u * cell[axis][1] + upper;
        if (has_values) {
            plr_jax_halve(f, corner, dim, axis, upper, split, *at_level, widths >> 8 & 31u);
        }
        node = 2u * split + 1u + upper;
    }
}

/* Turns values and derivatives at both ends of [0, 1] into the coefficients of a cubic. */
static inline void plr_jax_cubic(double *p, uint32_t stride)
{
    const double v0 = p[0], d0 = p[stride], v1 = p[2u * stride], d1 = p[3u * stride];
    p[2u * stride] = 3.0 * (v1 - v0) - 2.0 * d0 - d1;
    p[3u * stride] = 2.0 * (v0 - v1) + d0 + d1;
}

/* The numbers of smooth leaves at a corner of some leaf where they have a value: this, the derivatives by the second
   and the first coordinate, and by both; by fractions of the domain. Derivatives are means over the leaves around the
   corner whose functions agree there. If one of these is larger and has the corner on an edge, the numbers are those
   of its cubic, which follows from the ends of the edge. */
static inline void plr_jax_smooth(const struct plr_jax *f, struct plr_jax_path *path, const uint32_t *point,
                                  int32_t value, uint32_t depth, double *out)
{
    double weight[4] = {1.0, 0.0, 0.0, 0.0};
    uint32_t quadrant, axis, i, kind;
    out[0] = (double)value;
    out[1] = out[2] = out[3] = 0.0;
    for (quadrant = 0; quadrant < 4u; ++quadrant) {
        uint32_t place[2], cell[2][2], from[2], size[2], at_level, index = 0, edge = 2;
        int32_t corner[4] = {0, 0, 0, 0};
        int is_inside = 1;
        for (axis = 0; axis < 2u; ++axis) {
            place[axis] = point[axis] - (quadrant >> axis & 1u);
            is_inside = is_inside && (!(place[axis] >> 23)
                                      || plr_jax_frame(f, axis, PLR_JAX_LAST) > plr_jax_frame(f, axis, PLR_JAX_FIRST));
            place[axis] &= 0x7fffffu;
        }
        if (!is_inside) {
            continue;
        }
        plr_jax_descend(f, place, cell, corner, &at_level, path);
        for (axis = 0; axis < 2u; ++axis) {
            size[axis] = 1u << (23u - cell[axis][0]);
            from[axis] = place[axis] - cell[axis][1] * size[axis] + (quadrant >> axis & 1u);
            index |= from[axis] == size[axis] ? 2u >> axis : 0u;
            edge = from[axis] && from[axis] < size[axis] ? axis : edge;
        }
        if (edge < 2u) {
            const uint32_t across = 2u >> edge, along = size[edge];
            const double scale = (double)(1u << cell[edge][0]), t = (double)from[edge] / (double)along;
            uint32_t end[2];
            double p[2][4], q[4];
            if ((int64_t)corner[index] * (along - from[edge]) + (int64_t)corner[index | across] * from[edge]
                    != (int64_t)value * along
                || !depth) {
                continue;
            }
            end[edge] = cell[edge][1] * along;
            end[1u - edge] = point[1u - edge];
            plr_jax_smooth(f, path, end, corner[index], depth - 1u, p[0]);
            end[edge] += along;
            plr_jax_smooth(f, path, end, corner[index | across], depth - 1u, p[1]);
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
        if (corner[index] == value) {
            const double dx = (double)corner[2u | index] - (double)corner[index & 1u];
            const double dy = (double)corner[1u | index] - (double)corner[index & 2u];
            const double both = ((double)corner[3] - (double)corner[2]) - ((double)corner[1] - (double)corner[0]);
            for (kind = 1; kind < 4u; ++kind) {
                const double w = (kind & 2u ? (double)(1u << cell[0][0]) : 1.0)
                                 * (kind & 1u ? (double)(1u << cell[1][0]) : 1.0);
                weight[kind] += w;
                out[kind] += w * w * (kind == 1u ? dy : kind == 2u ? dx : both);
            }
        }
    }
    for (kind = 1; kind < 4u; ++kind) {
        out[kind] = out[kind] / weight[kind];
    }
}

/* The first of some sorted records that begins with a leaf's number or a larger one. */
static inline uint32_t plr_jax_find(const struct plr_jax *f, uint32_t at, uint32_t count, uint32_t size, uint32_t leaf)
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

/* The coefficients of a smooth leaf, from the values at its corners, or from a plane if the goal cannot be reached
   from the leaf. Not inline, as it takes more of the stack than all others together. */
PLR_JAX_APART uint32_t plr_jax_smooth_leaf(const struct plr_jax *f, const uint32_t *place, uint32_t (*cell)[2],
                                           float *n)
{
    static const signed char basis[4][4] = {{1, 0, -3, 2}, {0, 1, -2, 1}, {0, 0, 3, -2}, {0, 0, -1, 1}};
    const uint32_t size = (plr_jax_word(f, PLR_JAX_W_WIDTHS) >> 16 & 255u) + 192u;
    const uint32_t num_planes = plr_jax_word(f, PLR_JAX_W_NUM_PLANES), planes = plr_jax_word(f, PLR_JAX_W_PLANES);
    const double offset = (double)plr_jax_float(f, 32u * PLR_JAX_W_OFFSET);
    const double step = (double)plr_jax_float(f, 32u * PLR_JAX_W_STEP);
    uint32_t i, kind, axis, point[2], at, leaf, row;
    int32_t corner[4];
    int is_plane;
    double p[16], plane[3], sum;
    struct plr_jax_path path;
    path.last = 0;
    leaf = plr_jax_descend(f, place, cell, corner, &at, &path);
    row = plr_jax_find(f, planes, num_planes, size, leaf);
    at = planes + size * row;
    is_plane = row < num_planes && plr_jax_bits(f, at, size - 192u) == leaf;
    for (i = 0; i < 3u; ++i) {
        plane[i] = plr_jax_double(f, at + size - 192u + 64u * i);
    }
    for (i = 0; i < 4u; ++i) {
        double *const q = p + 4u * i;
        if (is_plane) {
            q[0] = plane[0] + ((i & 2u ? plane[1] : -plane[1]) + (i & 1u ? plane[2] : -plane[2]));
            q[1] = 2.0 * plane[2];
            q[2] = 2.0 * plane[1];
            q[3] = 0.0;
            continue;
        }
        for (axis = 0; axis < 2u; ++axis) {
            point[axis] = (cell[axis][1] + (i >> (1u - axis) & 1u)) << (23u - cell[axis][0]);
        }
        plr_jax_smooth(f, &path, point, corner[i], 8, q);
        for (kind = 0; kind < 4u; ++kind) {
            const double width = (kind & 2u ? (double)(1u << cell[0][0]) : 1.0)
                                 * (kind & 1u ? (double)(1u << cell[1][0]) : 1.0);
            q[kind] = (kind ? 0.0 : offset) + step * q[kind] / width;
        }
    }
    for (i = 0; i < 16u; ++i) {
        sum = 0.0;
        for (kind = 0; kind < 16u; ++kind) { /* corner by corner, at each of them value and derivatives */
            const uint32_t first = (kind >> 2 & 2u) | (kind >> 1 & 1u), second = (kind >> 1 & 2u) | (kind & 1u);
            sum = sum + p[kind] * (double)(basis[first][i >> 2] * basis[second][i & 3u]);
        }
        n[i] = (float)sum;
    }
    return leaf;
}

/* Turns a point, relative to the lower corner of a far domain, into offsets from the corner of the stored part, and
   finds its leaf: per axis the number of halvings and the position of its cell, and its numbers. Returns 0 for
   points outside. With a constant set of models, compilers leave out the code of others. */
static inline int plr_jax_leaf(const struct plr_jax *f, float *x, uint32_t (*cell)[2], float *n, uint32_t models)
{
    const uint32_t kind = plr_jax_word(f, PLR_JAX_W_KIND), dim = kind & 255u, flags = kind >> 16 & 255u;
    const uint32_t terms = plr_jax_word(f, PLR_JAX_W_TERMS), rows = plr_jax_word(f, PLR_JAX_W_ROWS);
    const uint32_t odd = plr_jax_word(f, PLR_JAX_W_ODD), num_odd = plr_jax_word(f, PLR_JAX_W_NUM_ODD);
    const uint32_t index_bits = plr_jax_word(f, PLR_JAX_W_WIDTHS) >> 16 & 255u;
    const float step = plr_jax_float(f, 32u * PLR_JAX_W_STEP);
    const double offset = (double)plr_jax_float(f, 32u * PLR_JAX_W_OFFSET);
    uint32_t place[PLR_JAX_MAX_DIM], axis, i, leaf, first, at_level = 0, at, width;
    int32_t corner[64];
    int is_smooth;

    /* 1. Place. */
    for (axis = 0; axis < dim; ++axis) {
        if (!(x[axis] >= plr_jax_frame(f, axis, PLR_JAX_LEAST) && x[axis] <= plr_jax_frame(f, axis, PLR_JAX_MOST))) {
            return 0;
        }
    }
    if (flags & PLR_JAX_FOLDED) {
        plr_jax_fold(f, x, dim, flags);
    }
    for (axis = 0; axis < dim; ++axis) {
        const float lo = plr_jax_frame(f, axis, PLR_JAX_FIRST), hi = plr_jax_frame(f, axis, PLR_JAX_LAST);
        const float scale = plr_jax_frame(f, axis, PLR_JAX_SCALE), top = plr_jax_frame(f, axis, PLR_JAX_TOP);
        float share;
        if (hi > lo) {
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
    leaf = is_smooth ? plr_jax_smooth_leaf(f, place, cell, n)
                     : plr_jax_descend(f, place, cell, corner, &at_level, NULL);
    at = is_smooth ? 0 : plr_jax_bits(f, at_level, 32);
    width = is_smooth ? 0 : plr_jax_bits(f, at_level + 32u, 8);

    /* 2. Numbers that are stored as floats. */
    if (!(flags & PLR_JAX_CODED)) {
        at = rows + 32u * terms * plr_jax_bits(f, at + width * leaf, width);
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
        /* 4. Or value at the corner of the domain and slopes, from the value at the center and the rise along axes. */
        double center, sum = 0.0;
        for (axis = 0, i = 0; axis <= dim; ++axis) {
            i += plr_jax_bits(f, at_level + 32u + 8u * axis, 8);
        }
        at += i * leaf;
        center = offset + (double)step * (double)plr_jax_bits(f, at, width);
        for (axis = 0; axis < dim; ++axis) {
            const double lo = plr_jax_exact(f, axis, PLR_JAX_LEAF_LO), hi = plr_jax_exact(f, axis, PLR_JAX_LEAF_HI);
            const double size = 1.0 / (double)(1u << cell[axis][0]), to = (double)(cell[axis][1] + 1u) * size;
            const double l = lo + (hi - lo) * ((double)cell[axis][1] * size);
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

    /* 5. Numbers that differ from these, sorted by leaf; the first of a leaf may say that all others are 0. */
    first = plr_jax_find(f, odd, num_odd, index_bits + 9u, leaf);
    for (; first < num_odd; ++first) {
        at = odd + (index_bits + 9u) * first;
        if (plr_jax_bits(f, at, index_bits) != leaf) {
            break;
        }
        i = plr_jax_bits(f, at + index_bits, 8);
        if (plr_jax_bits(f, at + index_bits + 8u, 1)) {
            memset(n, 0, terms * sizeof *n);
        }
        if (i < terms) {
            n[i] = plr_jax_float(f, rows + 32u * first);
        }
    }
    return 1;
}

/* The value at a point that was not found to be outside, from the results of plr_jax_leaf. */
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
        return sum;
    }
    if (!(models & (1u << PLR_JAX_CONTINUOUS | 1u << PLR_JAX_SMOOTH))) {
        return sum;
    }
    for (axis = dim; axis--;) { /* Horner's rule, the last axis first */
        const float start = plr_jax_frame(f, axis, PLR_JAX_START);
        float t = x[axis] * plr_jax_frame(f, axis, PLR_JAX_SCALE);
        t = start < 1.0f ? t + (start - 1.0f) : t;
        t = t * (float)(1u << cell[axis][0]) - (float)cell[axis][1];
        count /= powers;
        for (i = 0; i < count; ++i) {
            sum = n[powers * i + powers - 1u];
            for (k = powers - 1u; k--;) {
                sum = sum * t + n[powers * i + k];
            }
            n[i] = sum;
        }
    }
    return n[0];
}

/* Checks the bytes of a distance function and points to them; returns PLR_JAX_OK or what is wrong with them. */
static inline int plr_jax_open(struct plr_jax *f, const unsigned char *bytes, uint32_t size)
{
    uint32_t crc = 0xffffffffu, i, k, kind, dim, model, terms;
    f->bytes = bytes;
    f->size = size;
    if (plr_jax_word(f, PLR_JAX_W_MAGIC) != 0x31434c50u) {
        return PLR_JAX_NO_PLR;
    }
    if (plr_jax_word(f, PLR_JAX_W_SIZE) != size || size < 4u * PLR_JAX_NUM_WORDS + 5u || size >> 29) {
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
    i = model == PLR_JAX_PLANE || model == PLR_JAX_CONE ? 1u + dim : 1u << (model * dim & 31u);
    return !dim || dim > PLR_JAX_MAX_DIM || model > PLR_JAX_CONE || terms != i || terms > PLR_JAX_MAX_TERMS
                   || kind >> 24 > PLR_JAX_MAX_LEVELS || (model % 3u && dim > 6u) || (!(model % 3u) && kind >> 16 & PLR_JAX_VALUES)
               ? PLR_JAX_TOO_LARGE
               : PLR_JAX_OK;
}

/* The number of coordinates of a point. */
static inline uint32_t plr_jax_dim(const struct plr_jax *f)
{
    return plr_jax_word(f, PLR_JAX_W_KIND) & 255u;
}

/* Whether the domain is far from the origin, so that points are doubles. */
static inline int plr_jax_is_far(const struct plr_jax *f)
{
    return (int)(plr_jax_word(f, PLR_JAX_W_KIND) >> 16 & PLR_JAX_FAR);
}

/* The distance at a point and at z, the same point relative to a far domain. */
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

/* The distance to the goal, of a set of leaf models. */
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

/* For cones: the next waypoint on the way to the goal; NAN outside the domain. */
static inline void plr_jax_waypoint(const struct plr_jax *f, const float *x, float *waypoint)
{
    const uint32_t dim = plr_jax_dim(f);
    uint32_t cell[PLR_JAX_MAX_DIM][2], axis;
    float z[PLR_JAX_MAX_DIM], n[PLR_JAX_MAX_TERMS];
    int is_inside;
    memcpy(z, x, dim * sizeof *x);
    is_inside = plr_jax_leaf(f, z, cell, n, 1u << PLR_JAX_CONE);
    for (axis = 0; axis < dim; ++axis) {
        waypoint[axis] = is_inside ? plr_jax_frame(f, axis, PLR_JAX_LO) + n[1u + axis] : NAN;
    }
}

/* Moves a point around periodic axes in 64 bits, and takes it relative to the lower corner of the domain. */
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

/* As plr_jax_distance_of and plr_jax_distance, for domains far from the origin. */
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

/* As plr_jax_waypoint, for domains far from the origin. */
static inline void plr_jax_waypoint_far(const struct plr_jax *f, const double *x, double *waypoint)
{
    const uint32_t dim = plr_jax_dim(f);
    uint32_t cell[PLR_JAX_MAX_DIM][2], axis;
    float z[PLR_JAX_MAX_DIM], n[PLR_JAX_MAX_TERMS];
    int is_inside;
    plr_jax_place_far(f, x, z, dim);
    is_inside = plr_jax_leaf(f, z, cell, n, 1u << PLR_JAX_CONE);
    for (axis = 0; axis < dim; ++axis) {
        waypoint[axis] = is_inside ? plr_jax_exact(f, axis, PLR_JAX_DOMAIN_LO) + (double)n[1u + axis] : NAN;
    }
}

#endif
