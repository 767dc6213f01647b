// The costs of a tile of the plane sweep, once for every instruction set (included by stereo_*.cpp after windows and warps).
#pragma once
#include "plane_sweep.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr float kNoVote = -2.0f;  // below any correlation
alignas(64) static const float kLaneColumns[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};

static void load_tile(const SweepTask& task, const Tile& tile, SweepWorkspace& w) {
    load_pixels(task, tile, w);
    for (int r = 0; r < tile.rows; ++r)
        for (int x = 0; x < kTileColumns; x += kWidth) prepare_window(task.window, r, x, w);
    for (size_t k = 0; k < task.partners.size(); ++k) {
        const uint8_t* visible = task.partners[k].visible;
        for (int r = 0; r < tile.rows; ++r) {
            const int64_t row = int64_t(tile.row + r) * task.width + tile.column;
            for (int x = 0; x < kTileColumns; ++x)
                w.trust[k][r][x] = !visible || x >= tile.columns || visible[row + x] ? 1.0f : task.hidden_weight;
        }
    }
}

// Correlations with one partner; kNoVote where its image ends, and where an image holds what is no number.
static void score_plane(const SweepTask& task, const Tile& tile, int k, const PlaneMap& map, SweepWorkspace& w) {
    for (int r = 0; r < tile.rows; ++r) {
        const Interval seen = seen_columns(task.partners[k], map, tile.row + r);
        for (int x = 0; x < kTileColumns; x += 2 * kWidth) {
            F score[2];
            correlate(task.window, w, r, x, score);
            for (int n = 0; n < 2; ++n) {
                F column = all(float(tile.column + x + n * kWidth)) + load(kLaneColumns);
                M inside = both(at_most(all(seen.first), column), at_most(column, all(seen.last)));
                inside = both(inside, at_most(all(kNoVote), score[n]));
                store(&w.scores[k][r][x + n * kWidth], select(inside, score[n], all(kNoVote)));
            }
        }
    }
}

// Mean of the votes, weighted by trust; kNoVote where there is none.
GGVS_INLINE F trusted_mean(const SweepWorkspace& w, int partners, int r, int x) {
    F total = all(0.0f), sum = total;
    for (int k = 0; k < partners; ++k) {
        F score = load(&w.scores[k][r][x]);
        F trust = select(less(all(kNoVote), score), load(&w.trust[k][r][x]), all(0.0f));
        total = total + trust;
        sum = sum + trust * score;
    }
    M voted = less(all(0.0f), total);
    return select(voted, sum / select(voted, total, all(1.0f)), all(kNoVote));
}

// Mean of the better half of the votes; kNoVote where there is none.
GGVS_INLINE F better_half(const SweepWorkspace& w, int partners, int r, int x) {
    F best[(kMaxPartners + 1) / 2], votes = all(0.0f);
    const int kept = (partners + 1) / 2;
    for (F& value : best) value = all(kNoVote);
    for (int k = 0; k < partners; ++k) {
        F score = load(&w.scores[k][r][x]);
        votes = votes + select(less(all(kNoVote), score), all(1.0f), all(0.0f));
        for (int i = 0; i < kept; ++i) {
            F better = max(best[i], score);
            score = min(best[i], score);
            best[i] = better;
        }
    }
    F sum = best[0], half = max(to_float(truncate(all(0.5f) * votes + all(0.5f))), all(1.0f));
    for (int i = 1; i < kept; ++i) sum = sum + select(less(all(float(i)), half), best[i], all(0.0f));
    return sum / half;
}

static void cost_plane(const SweepTask& task, const Tile& tile, uint8_t (*costs)[kTileColumns], SweepWorkspace& w) {
    const int partners = int(task.partners.size());
    const bool trusted = task.partners[0].visible != nullptr;
    for (int r = 0; r < tile.rows; ++r) {
        for (int x = 0; x < kTileColumns; x += kWidth) {
            F fit = trusted ? trusted_mean(w, partners, r, x) : better_half(w, partners, r, x);
            fit = select(at_most(fit, all(kNoVote)), all(kUnseenFit), min(max(fit, all(0.0f)), all(1.0f)));
            store(w.rounded + x, truncate(all(float(kCostLimit)) * (all(1.0f) - fit) + all(0.5f)));
        }
        for (int x = 0; x < kTileColumns; ++x) costs[r][x] = uint8_t(w.rounded[x]);
    }
}

// Four perfect shuffles transpose 16 x 16 bytes.
GGVS_INLINE void shuffle(const uint8_t* in, uint8_t* out) {
    for (int i = 0; i < 128; ++i) {
        out[2 * i] = in[i];
        out[2 * i + 1] = in[i + 128];
    }
}

// From costs of pixels, plane by plane, to costs of planes, pixel by pixel.
static void store_costs(const SweepTask& task, const Tile& tile, int first_plane, uint8_t* costs, const SweepWorkspace& w) {
    static_assert(kPlaneBlock == 16, "the transposition is one of 16 x 16");
    alignas(64) uint8_t a[256], b[256];
    for (int r = 0; r < tile.rows; ++r) {
        uint8_t* out = costs + (int64_t(tile.row + r) * task.width + tile.column) * task.planes + first_plane;
        for (int x = 0; x < tile.columns; x += 16) {
            for (int p = 0; p < 16; ++p) __builtin_memcpy(a + 16 * p, &w.costs[p][r][x], 16);
            shuffle(a, b), shuffle(b, a), shuffle(a, b), shuffle(b, a);
            const int count = tile.columns - x < 16 ? tile.columns - x : 16;
            for (int i = 0; i < count; ++i) __builtin_memcpy(out + int64_t(x + i) * task.planes, a + 16 * i, 16);
        }
    }
}

static void sweep_tile(const SweepTask& task, const Tile& tile, uint8_t* costs, SweepWorkspace& w) {
    load_tile(task, tile, w);
    for (int block = 0; block < task.planes; block += kPlaneBlock) {
        __builtin_memset(w.costs, kCostLimit, sizeof w.costs);
        for (int plane = block; plane < block + kPlaneBlock; ++plane) {
            if (plane < tile.first_plane || plane >= tile.last_plane) continue;
            for (size_t k = 0; k < task.partners.size(); ++k) {
                const PlaneMap map = plane_map(task, task.partners[k], plane);
                place_columns(task, task.partners[k], map, tile, w.columns);
                warp_plane(task, task.partners[k], map, tile, w);
                score_plane(task, tile, int(k), map, w);
            }
            cost_plane(task, tile, w.costs[plane - block], w);
        }
        store_costs(task, tile, block, costs, w);
    }
}

}  // namespace ggvs::GGVS_LEVEL
