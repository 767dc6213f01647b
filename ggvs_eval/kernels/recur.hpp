// The previous output mixed into a picture.
#pragma once
#include <cstdint>

namespace ggvs {

// Two pictures of one size, and what is decided for cells of them.
struct Recurrence {
    int width, height, across, down;
    const float *now, *past;  // (height, width, 3)
    const float* cells;       // (4, down, across): weight of the past, and red, green and blue of what is taken off the mix
};

// now + weight (past - now) - light, a past that is not finite counting as now, with weight and light enlarged bilinearly to the size of the pictures.
void recur(const Recurrence& job, float* out, int threads);

}  // namespace ggvs
