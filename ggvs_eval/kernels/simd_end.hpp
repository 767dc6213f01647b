// Ends what simd_avx2.hpp or simd_avx512.hpp began: code after this runs on any processor again.
// No #pragma once: it belongs to the one before it, as a closing bracket does.
#if defined(__clang__)
#pragma clang attribute pop
#else
#pragma GCC pop_options
#endif
