@@ header
#ifndef PLR_JAX_@NAME@_H
#define PLR_JAX_@NAME@_H
/* Shortest paths between all pairs of cells of a grid of @ROWS@ x @COLUMNS@, @CONNECTIVITY@-connected, by plr_jax.

   @NAME@_open: takes the @SIZE@ bytes of the file of tables, mapped or read, at an address that 64 divides. Returns 1,
   or 0 if the bytes do not belong to this header. Each file of code that includes this header must call it, with
   result 1, before the other functions. The bytes must stay where they are.
   @NAME@_check: whether the bytes are undamaged; it reads all of them. With damaged bytes, the functions below may read
   beyond the end.
   @NAME@_steps: length in steps of a shortest path between two cells, rounded down on 8-connected grids. The cell in
   row r and column c has the number @COLUMNS@ r + c. -1 if no path joins the cells, or a cell is blocked or does not
   exist.
   @NAME@_units: the same, not rounded, in units: a straight step has @UNIT@, a diagonal step @DIAGONAL@.
   @NAME@_steps_of_pairs: the same as @NAME@_steps for n pairs of cells.

   All functions but @NAME@_open may be called by many threads at once. They allocate nothing. */

#include <stddef.h>
#include <stdint.h>
#include <string.h>

static const unsigned char *@NAME@_data;

static inline int @NAME@_open(const void *data, size_t size)
{
    uint32_t crc;
    const unsigned char *bytes = (const unsigned char *)data;
    if (size != @BYTES@u || memcmp(bytes, "plr_jax grid 1\n", 16) != 0)
        return 0;
    crc = (uint32_t)bytes[size - 4] | (uint32_t)bytes[size - 3] << 8 | (uint32_t)bytes[size - 2] << 16
        | (uint32_t)bytes[size - 1] << 24;
    if (crc != @CRC@u)
        return 0;
    @NAME@_data = bytes;
    return 1;
}

static inline int @NAME@_check(void)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < @BYTES@u - 4u; ++i) {
        crc ^= @NAME@_data[i];
        for (int bit = 0; bit < 8; ++bit)
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return (crc ^ 0xFFFFFFFFu) == @CRC@u;
}

@ARRAYS@

static inline int32_t @NAME@_abs(int32_t x) { return x < 0 ? -x : x; }

static inline int32_t @NAME@_open_length(int32_t rows, int32_t columns)
{
    const int32_t r = @NAME@_abs(rows), c = @NAME@_abs(columns), diagonal = r < c ? r : c;
    return @UNIT@ * (r + c - 2 * diagonal) + @DIAGONAL@ * diagonal;
}

static inline int @NAME@_is_free(uint32_t cell)
{
    return (int)((uint32_t)@NAME@_free(cell >> 5) >> (cell & 31u) & 1u);
}
@SIGHT@
@DISTANCES@
/* The corners that a cell lists, its distance from each, and each one's distance on an empty grid to another cell. */
static inline uint32_t @NAME@_corners(
    uint32_t cell, int32_t row, int32_t column, int32_t to_row, int32_t to_column, int32_t *corner, int32_t *leg,
    int32_t *way)
{
    const uint32_t first = (uint32_t)(@NAME@_group_block(cell / @GROUP@u) + @NAME@_cell_block(cell));
    const uint32_t end = (uint32_t)(@NAME@_group_block((cell + 1) / @GROUP@u) + @NAME@_cell_block(cell + 1));
    uint32_t count = 0;
    for (uint32_t i = @BLOCK@u * first; i < @BLOCK@u * end; ++i) {
        const int32_t c = @NAME@_blocks(i);
        const int32_t r = @NAME@_row((uint32_t)c), k = @NAME@_column((uint32_t)c);
        if (count && corner[count - 1] == c)
            break; /* padding of the last block */
        corner[count] = c;
        leg[count] = @NAME@_open_length(r - row, k - column);
        way[count++] = @NAME@_open_length(r - to_row, k - to_column);
    }
    return count;
}

static inline int32_t @NAME@_units(uint32_t from, uint32_t to)
{
    int32_t corner[@MOST@], leg[@MOST@], way[@MOST@], other[@MOST@], other_leg[@MOST@], other_way[@MOST@];
    int32_t best = @FAR@;
    uint32_t count, others, nearest = 0;
    if (from >= @CELLS@u || to >= @CELLS@u || !@NAME@_is_free(from) || !@NAME@_is_free(to))
        return -1;
    const int32_t row = (int32_t)(from / @COLUMNS@u), column = (int32_t)(from % @COLUMNS@u);
    const int32_t to_row = (int32_t)(to / @COLUMNS@u), to_column = (int32_t)(to % @COLUMNS@u);
    if (@NAME@_sees(row, column, to_row, to_column))
        return @NAME@_open_length(row - to_row, column - to_column);
    count = @NAME@_corners(from, row, column, to_row, to_column, corner, leg, way);
    others = @NAME@_corners(to, to_row, to_column, row, column, other, other_leg, other_way);
    if (!count || !others)
        return -1;
    for (uint32_t i = 1; i < count; ++i)
        if (leg[i] + way[i] < leg[nearest] + way[nearest])
            nearest = i;
    /* Swap the nearest with the first. No path through a corner is shorter than on an empty grid. */
    for (uint32_t i = 0; i < count; ++i) {
        const uint32_t k = i == 0 ? nearest : i == nearest ? 0 : i;
        if (leg[k] + way[k] >= best)
            continue;
        for (uint32_t j = 0; j < others; ++j) {
            if (other_leg[j] + other_way[j] < best) {
                const int32_t length = leg[k] + @NAME@_between_corners(corner[k], other[j]) + other_leg[j];
                best = length < best ? length : best;
            }
        }
        if (best >= @FAR@)
            return -1; /* if no path joins these corners, no path joins any */
    }
    return best;
}

static inline int32_t @NAME@_steps(uint32_t from, uint32_t to)
{
    const int32_t length = @NAME@_units(from, to);
    return length < 0 ? -1 : length / @UNIT@;
}

static inline void @NAME@_steps_of_pairs(const uint32_t *from, const uint32_t *to, int32_t *steps, size_t n)
{
    for (size_t i = 0; i < n; ++i)
        steps[i] = @NAME@_steps(from[i], to[i]);
}

#endif
@@ sight 4

/* Whether the rectangle between free cells is free, by prefix sums of blocked cells. */
static inline int @NAME@_sees(int32_t row, int32_t column, int32_t to_row, int32_t to_column)
{
    const uint32_t top = (uint32_t)(row < to_row ? row : to_row) * (@COLUMNS@u + 1u);
    const uint32_t end = ((uint32_t)(row < to_row ? to_row : row) + 1u) * (@COLUMNS@u + 1u);
    const uint32_t left = (uint32_t)(column < to_column ? column : to_column);
    const uint32_t right = (uint32_t)(column < to_column ? to_column : column) + 1u;
    return @NAME@_sums(end + right) - @NAME@_sums(end + left) == @NAME@_sums(top + right) - @NAME@_sums(top + left);
}
@@ sight 8

/* Whether all steps in the parallelogram between free cells are legal, by prefix sums over rows and slanted columns.
   The grid is flipped so that steps lead to higher rows and columns, by no fewer columns than rows. */
static inline int @NAME@_sees(int32_t row, int32_t column, int32_t to_row, int32_t to_column)
{
    const int transposed = @NAME@_abs(to_row - row) > @NAME@_abs(to_column - column);
    const int mirrored = (to_row < row && to_column > column) || (to_row > row && to_column < column);
    const int straight = row == to_row || column == to_column;
    const int32_t width = transposed ? @ROWS@ : @COLUMNS@;
    int32_t r = transposed ? column : row, to_r = transposed ? to_column : to_row;
    int32_t c = transposed ? row : column, to_c = transposed ? to_row : to_column, swap;
    uint32_t table, first, last, aside;
    int32_t count;
    if (mirrored) {
        c = width - 1 - c;
        to_c = width - 1 - to_c;
    }
    if (to_r < r) {
        swap = r;
        r = to_r;
        to_r = swap;
    }
    if (to_c < c) {
        swap = c;
        c = to_c;
        to_c = swap;
    }
    table = (@ROWS@u + 1u) * (@COLUMNS@u + 1u) * (3u * (uint32_t)transposed + (straight ? 2u : (uint32_t)mirrored));
    first = table + (uint32_t)(r + 1) * ((uint32_t)width + 1u);
    last = table + (uint32_t)(to_r + 1) * ((uint32_t)width + 1u);
    aside = (uint32_t)(to_r - r);
    count = @NAME@_sums(last + (uint32_t)to_c + 1u) - @NAME@_sums(last + (uint32_t)c + aside);
    if (!straight)
        count -= @NAME@_sums(first + (uint32_t)to_c - aside + 1u) - @NAME@_sums(first + (uint32_t)c);
    return count == 0;
}
@@ distances by table
static inline int32_t @NAME@_between_corners(int32_t a, int32_t b)
{
    const uint32_t high = (uint32_t)(a > b ? a : b), low = (uint32_t)(a > b ? b : a);
    const uint32_t center = (uint32_t)@NAME@_center((uint32_t)a), other = (uint32_t)@NAME@_center((uint32_t)b);
    return @NAME@_between_centers(center * @CENTERS@u + other) + @NAME@_differences(high * (high + 1) / 2 + low);
}
@@ distances by labels
/* The least sum over common ancestors: both lists of ancestors begin with them. */
static inline int32_t @NAME@_between_corners(int32_t a, int32_t b)
{
    uint32_t i = (uint32_t)@NAME@_first((uint32_t)a), j = (uint32_t)@NAME@_first((uint32_t)b);
    const uint32_t end = (uint32_t)@NAME@_first((uint32_t)a + 1), other_end = (uint32_t)@NAME@_first((uint32_t)b + 1);
    int32_t least = @FAR@;
    for (; i < end && j < other_end && @NAME@_ancestor(i) == @NAME@_ancestor(j); ++i, ++j) {
        const int32_t length = @NAME@_length(i) + @NAME@_length(j);
        least = length < least ? length : least;
    }
    return least;
}
