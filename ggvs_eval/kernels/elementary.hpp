// Elementary functions out of additions, multiplications and divisions alone, which IEEE 754 rounds one way. Those of the C library
// and of vector libraries differ in their last bit from processor to processor. Computed in double, to about one unit in its last
// place; arguments of sine and cosine up to 1e5.
#pragma once
#include <cstdint>
#include <cstring>

namespace ggvs {

inline double from_bits(int64_t bits) {
    double value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

inline int64_t bits_of(double value) {
    int64_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}

// ln 2 and pi / 2 in parts, so that a multiple of the first part is exact.
constexpr double kLn2High = 0x1.62e42feep-1, kLn2Low = 0x1.a39ef35793c76p-33;
constexpr double kHalfPi[3] = {0x1.921fb544p0, 0x1.0b4611a6p-34, 0x1.3198a2e037073p-69};

inline int64_t nearest_whole(double value) { return int64_t(value < 0 ? value - 0.5 : value + 0.5); }

inline double polynomial(const double* coefficients, int count, double x) {
    double sum = coefficients[count - 1];
    for (int n = count - 2; n >= 0; --n) sum = sum * x + coefficients[n];
    return sum;
}

// With terms enough for a double, or for results that are rounded to single precision.
template <bool kSingle = false>
inline double exponential(double x) {
    static constexpr double kTaylor[] = {1.0,         1.0,          1.0 / 2,       1.0 / 6,        1.0 / 24,
                                         1.0 / 120,   1.0 / 720,    1.0 / 5040,    1.0 / 40320,    1.0 / 362880,
                                         1.0 / 3628800, 1.0 / 39916800, 1.0 / 479001600, 1.0 / 6227020800.0};
    if (!(x > -708)) return x == x ? 0.0 : x;
    if (x > 709) return from_bits(0x7ff0000000000000);
    const int64_t power = nearest_whole(x * 0x1.71547652b82fep0);
    const double rest = (x - double(power) * kLn2High) - double(power) * kLn2Low;
    return polynomial(kTaylor, kSingle ? 9 : 14, rest) * from_bits((power + 1023) << 52);
}

// Of a positive normal number.
template <bool kSingle>
inline double logarithm(double x) {
    static constexpr double kSeries[] = {1.0,      1.0 / 3,  1.0 / 5,  1.0 / 7,  1.0 / 9,  1.0 / 11,
                                         1.0 / 13, 1.0 / 15, 1.0 / 17, 1.0 / 19, 1.0 / 21, 1.0 / 23};
    const int64_t bits = bits_of(x), power = (bits - 0x3fe6a09e667f3bcd) >> 52;  // the mantissa between the roots of 1/2 and 2
    const double mantissa = from_bits(bits - power * (int64_t(1) << 52)), share = (mantissa - 1.0) / (mantissa + 1.0);
    const double of_mantissa = 2.0 * share * polynomial(kSeries, kSingle ? 6 : 12, share * share);
    return double(power) * kLn2High + (of_mantissa + double(power) * kLn2Low);
}

// Of a base that is not negative, and a positive exponent.
template <bool kSingle>
inline double power(double base, double exponent) {
    return base < 0x1p-1022 ? 0.0 : exponential<kSingle>(exponent * logarithm<kSingle>(base));
}

inline double sine_of_quadrant(double x, int64_t quadrant) {
    static constexpr double kSine[] = {1.0,
                                       -1.0 / 6,
                                       1.0 / 120,
                                       -1.0 / 5040,
                                       1.0 / 362880,
                                       -1.0 / 39916800,
                                       1.0 / 6227020800.0,
                                       -1.0 / 1307674368000.0,
                                       1.0 / 355687428096000.0};
    static constexpr double kCosine[] = {1.0,
                                         -1.0 / 2,
                                         1.0 / 24,
                                         -1.0 / 720,
                                         1.0 / 40320,
                                         -1.0 / 3628800,
                                         1.0 / 479001600,
                                         -1.0 / 87178291200.0,
                                         1.0 / 20922789888000.0,
                                         -1.0 / 6402373705728000.0};
    const double value = quadrant & 1 ? polynomial(kCosine, 10, x * x) : x * polynomial(kSine, 9, x * x);
    return quadrant & 2 ? -value : value;
}

// The sine of x after so many quarters of a turn.
inline double turned_sine(double x, int64_t quarters) {
    const int64_t whole = nearest_whole(x * 0x1.45f306dc9c883p-1);
    const double n = double(whole);
    return sine_of_quadrant(((x - n * kHalfPi[0]) - n * kHalfPi[1]) - n * kHalfPi[2], whole + quarters);
}

inline double sine(double x) { return turned_sine(x, 0); }
inline double cosine(double x) { return turned_sine(x, 1); }

}  // namespace ggvs
