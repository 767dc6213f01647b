// Partners' images on the planes of the sweep, once for every instruction set (included by stereo_*.cpp after a simd_*.hpp).
#pragma once
#include "plane_sweep.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr float kSmallestDenominator = 0.1f;  // nearer to a partner's centre nothing is matched

// A plane on which reference pixels (column, row) lie at (scale * column + shift[0], scale * row + shift[1]) of a partner.
struct PlaneMap {
    float scale, shift[2];  // scale 0: too near to the partner, or behind it
};

GGVS_INLINE PlaneMap plane_map(const SweepTask& task, const SweepPartner& partner, int plane) {
    const float inverse_depth = task.first + task.step * float(plane);
    const float denominator = 1.0f - partner.along * inverse_depth;
    if (denominator < kSmallestDenominator) return {0.0f, {0.0f, 0.0f}};
    const float scale = 1.0f / denominator;
    PlaneMap map{scale, {}};
    for (int n = 0; n < 2; ++n) map.shift[n] = (partner.start[n] + partner.slope[n] * inverse_depth) * scale + partner.origin[n];
    return map;
}

// Also of what is no number: then 0.
GGVS_INLINE float clamp_place(float x, float last) {
    x = x > 0.0f ? x : 0.0f;
    return x < last ? x : last;
}

static void place_columns(const SweepTask& task, const SweepPartner& partner, const PlaneMap& map, const Tile& tile,
                          ColumnPlaces& places) {
    const float limit = float(partner.width - 1);
    const int last = partner.width - 2, right = task.width - 1;
    for (int x = 0; x < kPaddedColumns; ++x) {
        const int column = clamp_index(tile.column + x - task.window.radius, right);
        const float at = clamp_place(map.scale * float(column) + map.shift[0], limit);
        const int whole = int(at), index = whole < last ? whole : last;
        places.index[x] = index;
        places.fraction[x] = at - float(index);
    }
    for (int x = 0; x < kPaddedColumns; x += kWidth) {
        const int32_t* index = places.index + x;
        const int from = index[kWidth - 1] - (kWidth - 1), base = from < index[0] ? from : index[0];
        bool side_by_side = base >= 0;
        for (int i = 0; i < kWidth; ++i) {
            const int ahead = index[i] - base - i;
            places.ahead[x + i] = float(ahead);
            side_by_side = side_by_side && (ahead == 0 || ahead == 1);
        }
        places.base[x / kWidth] = side_by_side ? base : -1;
    }
}

// The row of a partner's image that a row of the tile lies on, as far as the tile's columns reach.
static void blend_rows(const SweepPartner& partner, float at, const ColumnPlaces& places, int columns, float* blended) {
    at = clamp_place(at, float(partner.height - 1));
    const int whole = int(at), row = whole < partner.height - 2 ? whole : partner.height - 2;
    const float below = at - float(row), above = 1.0f - below;
    const float* first = partner.image + int64_t(row) * partner.width;
    const float* second = first + partner.width;
    const int from = places.index[0], to = places.index[columns - 1] + 2;  // places never go back
    for (int i = from; i < to; ++i) blended[i] = above * first[i] + below * second[i];
}

// The partner's image on a plane, as far as the tile and its border need it.
static void warp_plane(const SweepTask& task, const SweepPartner& partner, const PlaneMap& map, const Tile& tile,
                       SweepWorkspace& w) {
    const ColumnPlaces& places = w.columns;
    const int radius = task.window.radius, columns = kTileColumns + 2 * radius;
    float* blended = w.blended.data();
    for (int r = 0; r < tile.rows + 2 * radius; ++r) {
        const int row = clamp_index(tile.row + r - radius, task.height - 1);
        blend_rows(partner, map.scale * float(row) + map.shift[1], places, columns, blended);
        for (int x = 0; x < columns; x += kWidth) {
            const int base = places.base[x / kWidth];
            F left, right;
            if (base >= 0) {
                M behind = less(load(places.ahead + x), all(0.5f));
                F middle = load(blended + base + 1);
                left = select(behind, load(blended + base), middle);
                right = select(behind, middle, load(blended + base + 2));
            } else {
                I index = load(places.index + x);
                left = gather(blended, index), right = gather(blended + 1, index);
            }
            store(&w.warped[r][x], left + load(places.fraction + x) * (right - left));
        }
    }
}

struct Interval {
    float first, last;
};

// The columns of a row whose windows lie in the partner's image on a plane.
GGVS_INLINE Interval seen_columns(const SweepPartner& partner, const PlaneMap& map, int row) {
    const float at = map.scale * float(row) + map.shift[1];
    if (!(map.scale > 0.0f && at >= 0.0f && at <= float(partner.height - 1))) return {1.0f, 0.0f};
    const int above = int(at), below = clamp_index(above + 1, partner.height - 1);
    const float first = partner.first[above] < partner.first[below] ? partner.first[below] : partner.first[above];
    const float last = partner.last[above] < partner.last[below] ? partner.last[above] : partner.last[below];
    const float inverse = 1.0f / map.scale;
    return {(first - map.shift[0]) * inverse, (last - map.shift[0]) * inverse};
}

}  // namespace ggvs::GGVS_LEVEL
