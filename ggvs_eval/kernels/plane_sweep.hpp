// How well the partners' images fit the reference's on planes of constant depth: a cost volume.
//
// The measure is the normalised cross-correlation of two windows, in which a pixel counts the more the nearer it is to the middle
// one in place and colour: a window then ends at the edge of an object. It does not feel gain and offset between cameras.
#pragma once
#include <cstdint>
#include <vector>

namespace ggvs {

constexpr int kCostLimit = 127;  // no correlation
// What nobody sees is taken to fit halfway. Were it to fit not at all, any plane near enough to come into a partner's view would
// win at the border of the image, however badly it fits.
constexpr float kUnseenFit = 0.5f;
constexpr int kPlaneBlock = 16;  // planes come in multiples of it
constexpr int kTileColumns = 64;
constexpr int kTileRows = 16;
constexpr int kMaxRadius = 3;
constexpr int kMaxTaps = (2 * kMaxRadius + 1) * (2 * kMaxRadius + 1);
constexpr int kMaxPartners = 16;
constexpr int kPaddedRows = kTileRows + 2 * kMaxRadius;
constexpr int kPaddedColumns = kTileColumns + 16;  // room for the border on both sides, in whole vectors

// Two images are compared in windows of this kind.
struct SweepWindow {
    int radius;            // pixels
    float colour_scale;    // colours that differ by this count less than half, grey values
    float distance_scale;  // pixels this far count half
    float noise;           // variance of grey values that is no texture
};

// A partner's image as seen from its centre in the reference's orientation and scale. What the reference sees in (column, row) at
// the inverse depth w lies there at ((column, row) + start + slope * w) / (1 - along * w) + origin. All are array indices.
struct SweepPartner {
    const float* image;  // (height, width), grey, at least 2 x 2
    int height, width;
    const float* first;      // (height), first column of each row that has its whole window in the partner's image
    const float* last;       // (height), the last one; less than the first where there is none
    const uint8_t* visible;  // (reference's height, width), 0 = something hides it; or null
    float start[2], slope[2], origin[2], along;
};

struct SweepTask {
    const float* reference;  // (height, width), grey
    const uint8_t* guide;    // (height, width, 3), colour
    int height, width;
    SweepWindow window;
    float hidden_weight;  // of a partner where `visible` is 0
    float first, step;    // inverse depth of the first plane and from plane to plane
    int planes;
    std::vector<SweepPartner> partners;  // all of them with `visible`, or none
};

struct Tile {
    int row, column, rows, columns;
    int first_plane, last_plane;  // the planes worth a look, the last one excluded
};

// Where the columns of a tile lie in a partner's image: index + fraction. Neighbours mostly lie side by side, and a vector of
// them needs no gathering: it starts at `base`, and from some lane on everything is one further ahead.
struct ColumnPlaces {
    alignas(64) int32_t index[kPaddedColumns];
    alignas(64) float fraction[kPaddedColumns];
    alignas(64) float ahead[kPaddedColumns];  // 0 or 1
    int32_t base[kPaddedColumns / 4];         // of each vector; -1: anywhere
};

// What a thread needs for a tile.
struct SweepWorkspace {
    alignas(64) float grey[kPaddedRows][kPaddedColumns];
    alignas(64) float colour[3][kPaddedRows][kPaddedColumns];
    alignas(64) float weights[kTileRows][kMaxTaps][kTileColumns];    // sum to 1
    alignas(64) float contrast[kTileRows][kMaxTaps][kTileColumns];   // weights times (grey - mean)
    alignas(64) float scale[kTileRows][kTileColumns];                // 1 / deviation
    alignas(64) float trust[kMaxPartners][kTileRows][kTileColumns];  // weight of each partner
    alignas(64) float warped[kPaddedRows][kPaddedColumns];
    alignas(64) float scores[kMaxPartners][kTileRows][kTileColumns];
    alignas(64) int32_t rounded[kTileColumns];
    alignas(64) uint8_t costs[kPlaneBlock][kTileRows][kTileColumns];
    ColumnPlaces columns;
    std::vector<float> blended;  // one row of a partner, and whole vectors beyond it
};

// Costs of every plane, (height, width, planes), 0 = perfect fit. `ranges` (tiles down, tiles across, 2) says which planes are
// worth a look in each tile, the last one excluded; the others cost kCostLimit. Without `visible`, the better half of the partners
// that see a point count, since an object may hide it from the others.
void sweep_planes(const SweepTask& task, const int32_t* ranges, uint8_t* costs, int threads, int level);

}  // namespace ggvs
