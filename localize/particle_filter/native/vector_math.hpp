// Elementary functions without branches or calls: loops over them vectorise.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

namespace assignment {

constexpr double kPi = 3.14159265358979323846;

// arctan of t in [0, 1]: an odd polynomial around either half; |error| < 1e-10
inline double small_arctan(double t) {
  constexpr double tan_eighth = 0.41421356237309503;
  const bool upper = t > tan_eighth;
  const double x = (upper ? t - 1.0 : t) / (upper ? t + 1.0 : 1.0);
  const double q = x * x;
  double p = -1.0 / 23;
  p = p * q + 1.0 / 21;
  p = p * q - 1.0 / 19;
  p = p * q + 1.0 / 17;
  p = p * q - 1.0 / 15;
  p = p * q + 1.0 / 13;
  p = p * q - 1.0 / 11;
  p = p * q + 1.0 / 9;
  p = p * q - 1.0 / 7;
  p = p * q + 1.0 / 5;
  p = p * q - 1.0 / 3;
  p = p * q + 1.0;
  return (upper ? kPi / 4 : 0.0) + x * p;
}

inline double fast_atan2(double y, double x) {
  const double ax = std::fabs(x);
  const double ay = std::fabs(y);
  const double largest = ax > ay ? ax : ay;
  const double smallest = ax > ay ? ay : ax;
  const double t = smallest / (largest + 1e-300);
  double angle = small_arctan(t);
  angle = ay > ax ? kPi / 2 - angle : angle;
  angle = x < 0.0 ? kPi - angle : angle;
  return y < 0.0 ? -angle : angle;
}

// Natural logarithm of a positive, normal number; |error| < 1e-14. The loop over it vectorises,
// which one over std::log does not.
inline double fast_log(double value) {
  std::int64_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  // halves of the exponent range meet at sqrt(1/2), so that the mantissa stays around 1
  const std::int64_t shift = (bits - 0x3fe6a09e667f3bcdLL) >> 52;
  bits -= shift * (std::int64_t{1} << 52);
  double mantissa;
  std::memcpy(&mantissa, &bits, sizeof mantissa);
  const double r = (mantissa - 1.0) / (mantissa + 1.0);
  const double q = r * r;
  double p = 1.0 / 19;
  p = p * q + 1.0 / 17;
  p = p * q + 1.0 / 15;
  p = p * q + 1.0 / 13;
  p = p * q + 1.0 / 11;
  p = p * q + 1.0 / 9;
  p = p * q + 1.0 / 7;
  p = p * q + 1.0 / 5;
  p = p * q + 1.0 / 3;
  p = p * q + 1.0;
  return static_cast<double>(static_cast<std::int32_t>(shift)) * 0.69314718055994530942 +
         2.0 * r * p;
}

}  // namespace assignment
