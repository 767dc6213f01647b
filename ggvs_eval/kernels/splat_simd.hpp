// The splat's blending, written once for every instruction set (included by level_*.cpp after splat_project_simd.hpp, whose numbers
// of the steps are meant here). Sums stay in registers.
#pragma once
#include "splat.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr int kTogether = kWidth < 16 ? 2 : 4;  // Gaussians that are blended step by step together, as registers allow
// Rows of a vector, and of the pixels that share a list.
constexpr int kBlockRows = kWidth / kBlock, kListRows = kBlockRows < 2 ? 2 : kBlockRows;

// Step 6 for some Gaussians at once; 0 where a pixel is not touched. At the squared distance d from the middle alpha is 255^-d, and
// on the rim of the unit circle 1/255. A polynomial that is squared again and again, a constant added each time, has a high degree
// for few operations: fitted to 0 <= d <= 1 it is alpha to 1e-7, and rounded to 1e-6.
// Several at once, step by step: each step waits for the one before, and processors look ahead for work of their own only so far.
template <int kCount>
GGVS_INLINE void alphas_of(const Ellipse* const (&e)[kCount], F x, F y, M active, F (&alpha)[kCount]) {
    constexpr float kFirst = 0.0106465108f, kTerms[] = {-0.0521149507f, 0.244050601f, -0.689524064f, 1.00018627f};
    constexpr float kTermsOfSquares[] = {0.00397215164f, -0.00869712176f, -2.25079041e-05f};
    F distance[kCount];
    M touched[kCount];
#pragma GCC unroll 8
    for (int n = 0; n < kCount; ++n) {
        F across = multiply_add(all(e[n]->xx), x, multiply_add(all(e[n]->xy), y, all(e[n]->x)));
        F down = multiply_add(all(e[n]->yy), y, all(e[n]->y));
        distance[n] = multiply_add(across, across, down * down);
        touched[n] = both(active, at_most(distance[n], all(1.0f)));
        alpha[n] = all(kFirst);
    }
#pragma GCC unroll 4
    for (const float term : kTerms)
#pragma GCC unroll 8
        for (int n = 0; n < kCount; ++n) alpha[n] = multiply_add(alpha[n], distance[n], all(term));
#pragma GCC unroll 3
    for (const float term : kTermsOfSquares)
#pragma GCC unroll 8
        for (int n = 0; n < kCount; ++n) alpha[n] = multiply_add(alpha[n], alpha[n], all(term));
#pragma GCC unroll 8
    for (int n = 0; n < kCount; ++n) alpha[n] = keep(touched[n], min(alpha[n], all(0.99f)));
}

// One pixel per lane, in registers from the first Gaussian to the last.
template <int kChannels>
struct Sums {
    F transmittance, depth, features[kChannels];

    inline __attribute__((always_inline)) void add(const Ellipse& e, F weight) {
        depth = multiply_add(weight, all(e.depth), depth);
#pragma GCC unroll 4
        for (int c = 0; c < kChannels; ++c) features[c] = multiply_add(weight, all(e.features[c]), features[c]);
    }
};

// Steps 6 and 7 for the pixels (x, y) of a tile.
template <int kChannels>
GGVS_INLINE Sums<kChannels> blend(const Ellipse* list, const int32_t* chosen, int count, F x, F y) {
    const F zero = all(0.0f), least = all(1e-4f);
    M active = less(zero, all(1.0f));
    Sums<kChannels> sums;
    sums.transmittance = all(1.0f), sums.depth = zero;
#pragma GCC unroll 4
    for (int c = 0; c < kChannels; ++c) sums.features[c] = zero;
    for (int first = 0; first < count; first += kTogether) {
        const Ellipse* e[kTogether];
        F alpha[kTogether], weight[kTogether];
#pragma GCC unroll 8
        for (int n = 0; n < kTogether; ++n) e[n] = list + uint32_t(chosen[first + n]);
        alphas_of(e, x, y, active, alpha);
        F after = sums.transmittance;
#pragma GCC unroll 8
        for (int n = 0; n < kTogether; ++n) weight[n] = after * alpha[n], after = without_product(after, alpha[n], after);
        if (__builtin_expect(any(less(after, least)), 0)) {
            // One by one: a pixel stops BEFORE the Gaussian that would bring its transmittance below the least.
#pragma GCC unroll 1
            for (int n = 0; n < kTogether; ++n) {
                const Ellipse* const one[1] = {list + uint32_t(chosen[first + n])};
                F its[1];
                alphas_of(one, x, y, active, its);
                after = without_product(sums.transmittance, its[0], sums.transmittance);
                active = but_not(active, less(after, least));
                sums.add(*one[0], keep(active, sums.transmittance * its[0]));
                sums.transmittance = select(active, after, sums.transmittance);
            }
            if (!any(active)) break;
            continue;
        }
        sums.transmittance = after;
#pragma GCC unroll 8
        for (int n = 0; n < kTogether; ++n) sums.add(*e[n], weight[n]);
    }
    return sums;
}

// Step 8: alpha = 1 - T; if asked, the sums are divided by it where alpha > 1/255, and 0 elsewhere. They are written
// from (x, y) on, as far as the picture reaches.
template <int kChannels>
GGVS_INLINE void write_block(const SplatPicture& picture, const Sums<kChannels>& sums, int x, int y) {
    F alpha = all(1.0f) - sums.transmittance;
    F factor = picture.normalised ? select(less(all(kMinAlpha), alpha), all(1.0f) / alpha, all(0.0f)) : all(1.0f);
    F depth = sums.depth * factor, values[kMaxFeatures] = {alpha, alpha, alpha, alpha};  // what is no channel is not written
#pragma GCC unroll 4
    for (int c = 0; c < kChannels; ++c) values[c] = sums.features[c] * factor;
    const SplatImages& out = picture.out;
    const int64_t first = int64_t(y) * picture.width + x;
    if (kChannels == kMaxFeatures && x + kBlock <= picture.width && y + kBlockRows <= picture.height) {  // as is usual
        store_rows(out.alpha + first, picture.width, alpha), store_rows(out.depth + first, picture.width, depth);
        store_quads(out.features + first * kMaxFeatures, kMaxFeatures, picture.width * kMaxFeatures, values[0], values[1], values[2],
                    values[3]);
        return;
    }
    alignas(64) float alphas[kWidth], depths[kWidth], features[kWidth][kMaxFeatures];
    store(alphas, alpha), store(depths, depth);
    store_quads(features[0], kMaxFeatures, kBlock * kMaxFeatures, values[0], values[1], values[2], values[3]);
    for (int lane = 0; lane < kWidth; ++lane) {
        const int column = lane % kBlock, row = lane / kBlock;
        if (x + column >= picture.width || y + row >= picture.height) continue;
        const int64_t pixel = first + int64_t(row) * picture.width + column;
        out.alpha[pixel] = alphas[lane], out.depth[pixel] = depths[lane];
        __builtin_memcpy(out.features + pixel * kChannels, features[lane], kChannels * sizeof(float));
    }
}

// Lists of what may touch each of four parts of the tile, whose rows or columns are so many bits of a word each. What is behind the
// end of a list touches nothing. All four at once: each list is short, and its end no processor foresees. `words_of` reads a word of
// those that are shared out, `given` of them, from a place on.
template <int kTested, int kKept, class WordsOf>
GGVS_INLINE void share_out(int given, const WordsOf& words_of, int first_bit, int bits, TileList (&to)[4]) {
    I part[4];
    int32_t* end[3][4];  // of the words of each list
#pragma GCC unroll 4
    for (int n = 0; n < 4; ++n) {
        part[n] = all(int32_t(((1u << bits) - 1) << (first_bit + n * bits)));
#pragma GCC unroll 3
        for (int word = 0; word < kKept; ++word) end[word][n] = to[n].words[word];
    }
    for (int first = 0; first < given; first += kWidth) {
        I words[3];
#pragma GCC unroll 3
        for (int word = 0; word < 3; ++word)
            if (word < kKept || word == kTested) words[word] = words_of(word, first);
#pragma GCC unroll 4
        for (int n = 0; n < 4; ++n) {
            const M touched = share_bits(words[kTested], part[n]);
            const int count = count_of(touched);
#pragma GCC unroll 3
            for (int word = 0; word < kKept; ++word) pack(touched, words[word], end[word][n]), end[word][n] += count;
        }
    }
#pragma GCC unroll 4
    for (int n = 0; n < 4; ++n) {
#pragma GCC unroll 3
        for (int word = 1; word < kKept; ++word) store(end[word][n], all(int32_t(0)));
        to[n].count = int(end[0][n] - to[n].words[0]);
    }
}

template <int kTested, int kKept>
GGVS_INLINE void share_out(const TileList& from, int first_bit, int bits, TileList (&to)[4]) {
    const auto words_of = [&](int word, int first) { return load(from.words[word] + first); };
    share_out<kTested, kKept>(from.count, words_of, first_bit, bits, to);
}

// Four lists' pixels one below the other, from (x, y) of the tile on.
template <int kChannels>
GGVS_INLINE void blend_blocks(SplatTile& tile, const SplatPicture& picture, const TileList& column, int x, int y) {
    share_out<kRows, 1>(column, y / 2, kListRows / 2, tile.blocks);
    for (const TileList& block : tile.blocks) {
        for (int n = 0; n < kTogether; ++n) block.words[kGaussians][block.count + n] = tile.nothing;
        for (int part = 0; part < kListRows && tile.top + y < picture.height; part += kBlockRows, y += kBlockRows) {
            const F columns = load(kLaneColumn) + all(float(x)), rows = load(kLaneRow) + all(float(y));
            const auto sums = blend<kChannels>(tile.ellipses, block.words[kGaussians], block.count, columns, rows);
            write_block(picture, sums, tile.left + x, tile.top + y);
        }
    }
}

// By strips of 16 columns, cells of 16 x 16 pixels and the blocks' columns in these: what lies together is blended together, and a
// cell's Gaussians stay in the nearest cache.
template <int kChannels>
static void tile_of(SplatTile& tile, const SplatPicture& picture) {
    const auto words_of = [&](int word, int first) {
        const I numbers = load(tile.sorted + first);
        const int32_t* words = word == kRows ? tile.rows_of : tile.columns_of;
        return word == kGaussians ? numbers : gather_bytes((const uint8_t*)words, numbers << 2);
    };
    share_out<kColumns, 3>(tile.nothing, words_of, 0, 4, tile.strips);
    for (int left = 0; left < kTile && tile.left + left < picture.width; left += 16) {
        share_out<kRows, 3>(tile.strips[left / 16], 0, 8, tile.cells);
        for (int top = 0; top < kTile && tile.top + top < picture.height; top += 16) {
            share_out<kColumns, 2>(tile.cells[top / 16], left / kBlock, 1, tile.columns);
            for (int x = left; x < left + 16 && tile.left + x < picture.width; x += kBlock)
                for (int y = top; y < top + 16; y += 4 * kListRows)
                    blend_blocks<kChannels>(tile, picture, tile.columns[(x - left) / kBlock], x, y);
        }
    }
}

static void splat_tile(SplatTile& tile, int channels, const SplatPicture& picture) {
    switch (channels) {
        case 1:
            return tile_of<1>(tile, picture);
        case 2:
            return tile_of<2>(tile, picture);
        case 3:
            return tile_of<3>(tile, picture);
        default:
            return tile_of<4>(tile, picture);
    }
}

}  // namespace ggvs::GGVS_LEVEL
