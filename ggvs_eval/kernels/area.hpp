// Box averages: which pixels of a line a cell of a coarser line covers, and by how much.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

namespace ggvs {

// Pixels first .. last - 1 with their shares of the cell, which sum to 1 up to rounding.
struct Cell {
    int first, last;
    const float* shares;
};

// A line of `size` pixels cut into `cells` equal cells, cells <= size.
class AreaCells {
public:
    AreaCells(int size, int cells) {
        const double length = double(size) / cells;
        for (int n = 0; n < cells; ++n) {
            const double begin = n * length, end = std::min((n + 1) * length, double(size));
            // Overlaps below a millionth of a pixel are the rounding of begin and end.
            const int first = int(begin + 1e-6), last = std::min(int(std::ceil(end - 1e-6)), size);
            bounds_.push_back({first, last, int(shares_.size())});
            for (int x = first; x < last; ++x)
                shares_.push_back(float((std::min(x + 1.0, end) - std::max(double(x), begin)) / length));
        }
    }

    Cell operator[](int n) const { return {bounds_[n].first, bounds_[n].last, shares_.data() + bounds_[n].at}; }

private:
    struct Bounds {
        int first, last, at;
    };
    std::vector<Bounds> bounds_;
    std::vector<float> shares_;
};

}  // namespace ggvs
