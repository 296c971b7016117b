// Geometry and gains of seen poles and landmarks, for blocks of poses at once.
#pragma once

#include <cstdint>

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
constexpr int kVector = 8;
using Lane = double[kBlock];

struct Block {
  Lane east, north, cosine, sine;
};

// One landmark from the sensor of every pose of a block: ahead, left, squared range. False where it
// is out of range, or behind a sensor that looks ahead only, for all of them.
MULTIVERSION
static bool local_block(const Block& block, int lanes, double map_x, double map_y,
                        double origin_x, double origin_y, double nearest2, double farthest2,
                        double least_x, double* ahead, double* left, double* range2) {
  int reached = 0;
  for (int b = 0; b < lanes; ++b) {
    const double dx = map_x - block.east[b];
    const double dy = map_y - block.north[b];
    const double x = block.cosine[b] * dx + block.sine[b] * dy - origin_x;
    const double y = block.cosine[b] * dy - block.sine[b] * dx - origin_y;
    ahead[b] = x;
    left[b] = y;
    range2[b] = x * x + y * y;
    reached |= (range2[b] >= nearest2) & (range2[b] <= farthest2) & (x >= least_x);
  }
  return reached != 0;
}

MULTIVERSION
static void bearing_block(int lanes, const double* ahead, const double* left, double* bearing) {
  for (int b = 0; b < lanes; ++b) bearing[b] = fast_atan2(left[b], ahead[b]);
}

// What a landmark of a sight would cost if it were missed, and how much it is hoped for; zero where
// it is out of view.
struct Sight {
  double bearing_min, bins_per_rad, nearest2, farthest2;
  const double* free_range2;
  int bins;
};

MULTIVERSION
static void price_block(const Sight& sight, int lanes, double log_miss, double detection,
                        const double* range2, const double* bearing, double* price,
                        double* hope) {
  const double bins = sight.bins, last = sight.bins - 1;
  for (int b = 0; b < lanes; ++b) {
    const double column = (bearing[b] - sight.bearing_min) * sight.bins_per_rad;
    const double held = column < 0.0 ? 0.0 : column > last ? last : column;
    const double limit2 = sight.free_range2[static_cast<int>(held)];
    const bool seen = (range2[b] >= sight.nearest2) & (range2[b] <= sight.farthest2) &
                      (column >= 0.0) & (column < bins) & (range2[b] <= limit2);
    // the edge of the range is no wall: a miss says less the nearer to it
    const double fade = 1.0 - range2[b] / sight.farthest2;
    price[b] = seen ? fade * log_miss : 0.0;
    hope[b] = seen ? fade * detection : 0.0;
  }
}

MULTIVERSION
static void add_block(int lanes, const double* values, double* sum) {
  for (int b = 0; b < lanes; ++b) sum[b] += values[b];
}

// The best column so far of one row, for a block of poses; zero is "left alone".
struct Best {
  Lane gain, fit;
  std::uint64_t column[kBlock];  // one bit
};

MULTIVERSION
static void offer_block(int lanes, const double* gain, const double* price, const double* fit,
                        std::uint64_t column, Best* best) {
  for (int b = 0; b < lanes; ++b) {
    const double worth = gain[b] - price[b];
    const bool better = worth > best->gain[b];
    best->gain[b] = better ? worth : best->gain[b];
    best->fit[b] = better ? fit[b] : best->fit[b];
    best->column[b] = better ? column : best->column[b];
  }
}

// The rows of a block so far, each with its best column, whoever else wants that.
struct Greedy {
  Lane cost, fit;
  std::uint64_t taken[kBlock], clash[kBlock], matched[kBlock];
};

MULTIVERSION
static void take_block(int lanes, const Best& best, Greedy* sum) {
  for (int b = 0; b < lanes; ++b) {
    sum->cost[b] -= best.gain[b];
    sum->fit[b] += best.fit[b];
    sum->clash[b] |= sum->taken[b] & best.column[b];
    sum->taken[b] |= best.column[b];
    sum->matched[b] += best.column[b] != 0;
  }
}

// Where one seen pole stands in the map, from every pose of a block.
MULTIVERSION
static void place_block(const Block& block, int lanes, double x, double y, double* map_x,
                        double* map_y) {
  for (int b = 0; b < lanes; ++b) {
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
static void pair_block(const Block& block, int lanes, const Pair& pair, const double* pole_x,
                       const double* pole_y, double* gain, double* fit) {
  for (int b = 0; b < lanes; ++b) {
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
