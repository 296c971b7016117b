// Geometry and gains of seen poles and landmarks, for blocks of poses at once.
#pragma once

#include "vector_math.hpp"

// One binary, the widest vector unit of the machine that runs it: the loader picks the clone.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__linux__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define MULTIVERSION __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define MULTIVERSION
#endif

namespace assignment {

// Particles are weighed in blocks: neighbours see nearly the same, so they share the gating, and
// every loop runs over the block, where the compiler vectorises it.
constexpr int kBlock = 64;
using Lane = double[kBlock];

struct Block {
  Lane east, north, cosine, sine;
};

// Squared range and bearing of one landmark from the sensor of every pose of a block.
MULTIVERSION
static void sight_block(const Block& block, double map_x, double map_y, double origin_x,
                        double origin_y, double* range2, double* bearing) {
  for (int b = 0; b < kBlock; ++b) {
    const double dx = map_x - block.east[b];
    const double dy = map_y - block.north[b];
    const double x = block.cosine[b] * dx + block.sine[b] * dy - origin_x;
    const double y = block.cosine[b] * dy - block.sine[b] * dx - origin_y;
    range2[b] = x * x + y * y;
    bearing[b] = fast_atan2(y, x);
  }
}

// Where one seen pole stands in the map, from every pose of a block.
MULTIVERSION
static void place_block(const Block& block, double x, double y, double* map_x, double* map_y) {
  for (int b = 0; b < kBlock; ++b) {
    map_x[b] = block.east[b] + block.cosine[b] * x - block.sine[b] * y;
    map_y[b] = block.north[b] + block.sine[b] * x + block.cosine[b] * y;
  }
}

struct Pair {
  double pole_xx, pole_yy, pole_xy;  // covariance of the seen pole, vehicle axes
  double map_ee, map_nn, map_en;     // covariance of the landmark
  double map_x, map_y;
  double beta_p;
  double width_fit;   // -d_w^2 / (2 sigma_w^2), 0 where a width is unknown
  double constant;    // everything of the gain that does not depend on the pose
};

// Gain over "no match" (but for the price of a miss) and fit of one pair, for a block of poses.
MULTIVERSION
static void pair_block(const Block& block, const Pair& pair, const double* pole_x,
                       const double* pole_y, double* gain, double* fit) {
  for (int b = 0; b < kBlock; ++b) {
    const double c = block.cosine[b], s = block.sine[b];
    const double cc = c * c, ss = s * s, cs = c * s;
    const double ee = cc * pair.pole_xx - 2.0 * cs * pair.pole_xy + ss * pair.pole_yy + pair.map_ee;
    const double nn = ss * pair.pole_xx + 2.0 * cs * pair.pole_xy + cc * pair.pole_yy + pair.map_nn;
    const double en = cs * (pair.pole_xx - pair.pole_yy) + (cc - ss) * pair.pole_xy + pair.map_en;
    const double determinant = ee * nn - en * en;
    const double dx = pair.map_x - pole_x[b], dy = pair.map_y - pole_y[b];
    const double mahalanobis2 = (nn * dx * dx - 2.0 * en * dx * dy + ee * dy * dy) / determinant;
    fit[b] = pair.width_fit - 0.5 * pair.beta_p * mahalanobis2;
    gain[b] = pair.constant - 0.5 * fast_log(determinant) + fit[b];
  }
}

}  // namespace assignment
