// The inner loops of semi-global block matching, written once for every instruction set (included by stereo_*.cpp after a
// simd_*.hpp and sgm_simd.hpp, whose vectors of bytes they use).
#pragma once
#include "block_match.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr int kCosts = sizeof(H) / 2;  // in a vector
typedef uint8_t Narrow __attribute__((vector_size(kCosts)));

GGVS_INLINE H load_costs(const int16_t* p) {
    H v;
    __builtin_memcpy(&v, p, sizeof v);
    return v;
}
GGVS_INLINE H widen(const uint8_t* p) {
    Narrow v;
    __builtin_memcpy(&v, p, sizeof v);
    return __builtin_convertvector(v, H);
}
GGVS_INLINE void store_costs(int16_t* p, H v) { __builtin_memcpy(p, &v, sizeof v); }
GGVS_INLINE H all_costs(int x) { return H{} + int16_t(x); }
GGVS_INLINE H least(H a, H b) { return a < b ? a : b; }
GGVS_INLINE Bytes greatest(Bytes a, Bytes b) { return a > b ? a : b; }

// Of a pixel, the same in every lane, and of those that may match it: the value, and the range within half a pixel.
struct Ranges {
    Bytes value, low, high;
};
GGVS_INLINE Bytes outside(const Ranges& a, const Ranges& b) { return greatest(excess(a.value, b.high), excess(b.low, a.value)); }
GGVS_INLINE Bytes difference(const Ranges& a, const Ranges& b) { return least(outside(a, b), outside(b, a)); }

// Differences of the pixels of a row, (columns, count), and up to a vector behind them.
static void block_differences(const BlockTask& task, const BlockRows& rows, uint8_t* __restrict out) {
    const uint8_t *left[2][3], *right[2][3];
    for (int n = 0; n < 2; ++n) {
        const BlockGuide::Channel &one = rows.left.channels[n], &other = rows.right.channels[n];
        left[n][0] = one.value.data(), left[n][1] = one.low.data(), left[n][2] = one.high.data();
        right[n][0] = other.value.data(), right[n][1] = other.low.data(), right[n][2] = other.high.data();
    }
    const auto one = [&](int n, int x) { return Ranges{Bytes{} + left[n][0][x], Bytes{} + left[n][1][x], Bytes{} + left[n][2][x]}; };
    const auto some = [&](int n, int x) {
        return Ranges{load_bytes(right[n][0] + x), load_bytes(right[n][1] + x), load_bytes(right[n][2] + x)};
    };
    for (int x = task.count; x < task.width; ++x, out += task.count) {
        const Ranges slope = one(0, x), grey = one(1, x);
        for (int d = 0; d < task.count; d += kBytes) {
            const int at = task.width - 1 - x + d;
            store_bytes(out + d, difference(slope, some(0, at)) + (difference(grey, some(1, at)) >> 2));
        }
    }
}

#define GGVS_MEMBER inline __attribute__((always_inline))

// One step of a path to the next pixel, whose costs take the place of those of the pixel before. `lowest` is the least of these,
// in every lane.
struct Step {
    int16_t* path;
    H lowest, jump, slope, smallest;

    GGVS_MEMBER Step(const BlockTask& task, int16_t* path, H lowest)
        : path(path), lowest(lowest), jump(lowest + int16_t(task.large_step)), slope(all_costs(task.small_step)),
          smallest(all_costs(kLargestTotal)) {}

    // The path's costs at some disparities, of which the pixel's are `cost`, those before it `here`, and those of the neighbours.
    GGVS_MEMBER H go(int d, H cost, H here, H below, H above) {
        const H value = cost + (least(least(here, least(below, above) + slope), jump) - lowest);
        store_costs(path + d, value);
        smallest = least(smallest, value);
        return value;
    }
};

struct StepDown : Step {
    H below;

    GGVS_MEMBER StepDown(const BlockTask& task, int16_t* path, H lowest) : Step(task, path, lowest), below(load_costs(path - 1)) {}

    GGVS_MEMBER H take(int d, H cost) {
        const H next = load_costs(path + d + kCosts - 1);  // before it is written over
        const H value = go(d, cost, load_costs(path + d), below, load_costs(path + d + 1));
        below = next;
        return value;
    }
};

// Along a row memory has just been written, and to read across what was written at once takes long: vectors are shifted instead.
struct StepAside : Step {
    H last, here, middle;

    GGVS_MEMBER StepAside(const BlockTask& task, int16_t* path, H lowest)
        : Step(task, path, lowest), last(smallest - slope), here(load_costs(path)), middle(between(last, here)) {}

    GGVS_MEMBER H take(int d, H cost) {
        const H next = load_costs(path + d + kCosts), after = between(here, next);
        const H value = go(d, cost, here, lanes_before(last, middle, here), lanes_after(here, after, next));
        last = here, here = next, middle = after;
        return value;
    }
};
#undef GGVS_MEMBER

// Costs of the blocks of a row, and the paths from the left and from above; `window` has the differences of the block's rows.
// kBlock is the side of the block, 0 = any.
template <int kBlock>
GGVS_INLINE void forward(const BlockTask& task, BlockRows& rows, const uint8_t* const* window) {
    const int count = task.count, radius = kBlock > 0 ? kBlock / 2 : task.radius, block = 2 * radius + 1, last = task.columns() - 1;
    const uint8_t* own[kBlock > 0 ? kBlock : 1];  // which no other memory may be, for the compiler
    for (int n = 0; n < kBlock; ++n) own[n] = window[n];
    const uint8_t* const* differences = kBlock > 0 ? own : window;
    int16_t* running = rows.running.data();  // sum over the block
    const auto sum_column = [&](int column, int d) {
        const int64_t at = int64_t(column < last ? column : last) * count + d;
        H sum = widen(differences[0] + at);
        for (int n = 1; n < block; ++n) sum += widen(differences[n] + at);
        return sum;
    };
    for (int d = 0; d < count; d += kCosts) {  // of the block before the first one
        H sum{};
        for (int column = 0; column <= radius; ++column) {
            const H entering = sum_column(column, d);
            store_costs(rows.column_sum(column) + d, entering);
            if (column < radius || column == 0) sum += column == 0 ? entering * int16_t(radius + 1 + (radius > 0)) : entering;
        }
        store_costs(running + d, sum);
    }
    int16_t* along = rows.new_path();
    H lowest{};
    int slot = radius;  // of the sums that are kept: column modulo their number
    for (int x = 0; x <= last; ++x) {
        int16_t* entering = rows.column_sum(slot);
        slot = slot < block ? slot + 1 : 0;
        const int16_t* leaving = rows.column_sum(x > radius ? slot : 0);
        int16_t *costs = &rows.costs[int64_t(x) * count], *sums = &rows.sums[int64_t(x) * count];
        StepAside from_left(task, along, lowest);
        StepDown from_above(task, rows.down_path(x), all_costs(rows.down_least[x]));
        for (int d = 0; d < count; d += kCosts) {
            const H column = sum_column(x + radius, d), sum = load_costs(running + d) + column - load_costs(leaving + d);
            store_costs(entering + d, column);
            store_costs(running + d, sum);
            store_costs(costs + d, sum);
            store_costs(sums + d, from_left.take(d, sum) + from_above.take(d, sum));
        }
        lowest = least_everywhere(from_left.smallest);
        rows.down_least[x] = least_everywhere(from_above.smallest)[0];
    }
}

static void block_forward(const BlockTask& task, BlockRows& rows, const uint8_t* const* window) {
    task.radius == 1 ? forward<3>(task, rows, window) : forward<0>(task, rows, window);
}

// To a sixteenth of a pixel by the parabola through the neighbours of the best one. The division is OpenCV's of whole numbers:
// these are exact as floats, and their quotient, at most 9, is nearer to no other whole number.
GGVS_INLINE int in_sixteenths(const int16_t* total, int best, int count) {
    const int step = best > 0 && best < count - 1;
    const int below = total[best - step], above = total[best + step], bend = below + above - 2 * total[best];
    const int positive = bend > 1 ? bend : 1;
    return kDisparityStep * best + int(float(kDisparityStep * (below - above) + positive) / float(2 * positive));
}

// The path from the right, and the disparity of which the three paths together make least.
static void block_backward(const BlockTask& task, BlockRows& rows) {
    const int count = task.count;
    int16_t* total = rows.running.data();
    int16_t ascending[kCosts];
    for (int n = 0; n < kCosts; ++n) ascending[n] = int16_t(n);
    const H lanes = load_costs(ascending);
    int16_t* along = rows.new_path();
    H lowest{};
    for (int column = task.columns() - 1; column >= 0; --column) {
        const int16_t *costs = &rows.costs[int64_t(column) * count], *sums = &rows.sums[int64_t(column) * count];
        H best = all_costs(kLargestTotal), at{};
        StepAside from_right(task, along, lowest);
        for (int d = 0; d < count; d += kCosts) {
            const H sum = from_right.take(d, load_costs(costs + d)) + load_costs(sums + d);
            store_costs(total + d, sum);
            at = sum > best ? at : lanes + int16_t(d);
            best = least(best, sum);
        }
        lowest = least_everywhere(from_right.smallest);
        const H least_total = least_everywhere(best);
        // Of equal ones, as OpenCV's eight lanes choose: the last of each lane, and of those the first.
        const int disparity = least_of_larger(best == least_total ? at : all_costs(-1));
        const int x = column + count, matched = x - disparity;
        const bool better = least_total[0] < rows.total_of[matched];
        rows.match_of[matched] = better ? int16_t(disparity) : rows.match_of[matched];
        rows.total_of[matched] = better ? least_total[0] : rows.total_of[matched];
        rows.found[x] = int16_t(in_sixteenths(total, disparity, count));
    }
}

}  // namespace ggvs::GGVS_LEVEL
