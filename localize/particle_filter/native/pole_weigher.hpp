// Likelihood of a scan from every pose: gates, gains, and one assignment a pose.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "assigner.hpp"
#include "pose_blocks.hpp"

namespace assignment {

// Where the sensor looks: bearings and ranges from its origin in the vehicle frame.
struct View {
  double origin_x, origin_y, bearing_min, bearing_max, range_min;
  const double* free_range;
  int bins;
};

// One scan and the landmarks around; covariances are xx, yy, xy.
struct Problem {
  int poles, landmarks;
  const double *points, *covariance, *pole_width, *pole_log_gain;  // of the scan
  const double *map_points, *map_covariance, *map_width, *detection;  // of the map
  double beta_p, width_sd, log_width_gain;
  View view;
};

// Of every pose; `assignment` may be null.
struct Output {
  double *log_likelihood, *log_fit, *expected;
  std::int32_t *matched, *assignment;
};

// Weighs the poses begin..end-1.
class Weigher {
 public:
  explicit Weigher(const Problem& problem)
      : q_(problem),
        log_miss_(problem.landmarks),
        log_hit_(problem.landmarks),
        radius_(problem.poles),
        alone_(problem.poles, 0.0),
        match_(problem.poles),
        pole_x_(problem.poles * kBlock),
        pole_y_(problem.poles * kBlock),
        price_(problem.landmarks * kBlock) {
    double largest_map_variance = 0.0;
    double best_hit = -kInfinity;
    for (int l = 0; l < q_.landmarks; ++l) {
      log_miss_[l] = std::log1p(-q_.detection[l]);
      log_hit_[l] = std::log(q_.detection[l]);
      largest_map_variance =
          std::max(largest_map_variance, q_.map_covariance[3 * l] + q_.map_covariance[3 * l + 1]);
      best_hit = std::max(best_hit, log_hit_[l] - log_miss_[l]);
    }
    log_scale_ = std::log(q_.beta_p) - std::log(2.0 * kPi);
    for (int z = 0; z < q_.poles; ++z) {
      // beyond this distance even the best landmark is worth less than no match
      const double xx = q_.covariance[3 * z], yy = q_.covariance[3 * z + 1];
      const double xy = q_.covariance[3 * z + 2];
      const double gain = q_.pole_log_gain[z] + best_hit + log_scale_ +
                          std::max(0.0, q_.log_width_gain) - 0.5 * std::log(xx * yy - xy * xy);
      radius_[z] =
          gain > 0.0 ? std::sqrt(2.0 * gain * (xx + yy + largest_map_variance) / q_.beta_p) : -1.0;
    }
    for (int k = 0; k < q_.view.bins; ++k)
      free_range2_.push_back(q_.view.free_range[k] * q_.view.free_range[k]);
  }

  void weigh(const double* poses, std::ptrdiff_t begin, std::ptrdiff_t end, const Output& out) {
    for (std::ptrdiff_t first = begin; first < end; first += kBlock) {
      const int count = static_cast<int>(std::min<std::ptrdiff_t>(kBlock, end - first));
      for (int b = 0; b < kBlock; ++b) {
        // a block that is not full repeats its last pose
        const double* pose = poses + 3 * (first + std::min(b, count - 1));
        block_.east[b] = pose[0];
        block_.north[b] = pose[1];
        block_.cosine[b] = std::cos(pose[2]);
        block_.sine[b] = std::sin(pose[2]);
      }
      look();
      pair_up();
      for (int b = 0; b < count; ++b) settle(b, first + b, out);
    }
  }

 private:
  // What each landmark that is in view would cost if it were missed.
  void look() {
    std::fill(base_, base_ + kBlock, 0.0);
    std::fill(hoped_for_, hoped_for_ + kBlock, 0.0);
    const View& view = q_.view;
    if (view.bins == 0) {
      std::fill(price_.begin(), price_.end(), 0.0);
      return;
    }
    const double bins_per_rad = view.bins / (view.bearing_max - view.bearing_min);
    const double nearest2 = view.range_min * view.range_min;
    const double farthest2 = *std::max_element(free_range2_.begin(), free_range2_.end());
    for (int l = 0; l < q_.landmarks; ++l) {
      sight_block(block_, q_.map_points[2 * l], q_.map_points[2 * l + 1], view.origin_x,
                  view.origin_y, range2_, bearing_);
      double* price = &price_[static_cast<std::size_t>(l) * kBlock];
      for (int b = 0; b < kBlock; ++b) {
        price[b] = 0.0;
        if (range2_[b] < nearest2 || range2_[b] > farthest2) continue;
        const double column = (bearing_[b] - view.bearing_min) * bins_per_rad;
        if (column < 0.0 || column >= view.bins ||
            range2_[b] > free_range2_[static_cast<int>(column)])
          continue;
        // the edge of the range is no wall: a miss says less the nearer to it
        const double fade = 1.0 - range2_[b] / farthest2;
        price[b] = fade * log_miss_[l];
        base_[b] += price[b];
        hoped_for_[b] += fade * q_.detection[l];
      }
    }
  }

  // Lists the pairs that stand near enough for any pose of the block, and values them for all.
  void pair_up() {
    pairs_.clear();
    for (int z = 0; z < q_.poles; ++z) {
      double* x = &pole_x_[static_cast<std::size_t>(z) * kBlock];
      double* y = &pole_y_[static_cast<std::size_t>(z) * kBlock];
      place_block(block_, q_.points[2 * z], q_.points[2 * z + 1], x, y);
      if (radius_[z] < 0.0) continue;
      const auto span_x = std::minmax_element(x, x + kBlock);
      const auto span_y = std::minmax_element(y, y + kBlock);
      const double west = *span_x.first - radius_[z], east = *span_x.second + radius_[z];
      const double south = *span_y.first - radius_[z], north = *span_y.second + radius_[z];
      for (int l = 0; l < q_.landmarks; ++l) {
        const double map_x = q_.map_points[2 * l], map_y = q_.map_points[2 * l + 1];
        if (map_x < west || map_x > east || map_y < south || map_y > north) continue;
        pairs_.push_back({z, l, 0.0});
        const std::size_t offset = (pairs_.size() - 1) * kBlock;
        if (gain_.size() < offset + kBlock) {
          gain_.resize(offset + kBlock);
          fit_.resize(offset + kBlock);
        }
        pair_block(block_, pair_of(z, l), x, y, &gain_[offset], &fit_[offset]);
      }
    }
  }

  Pair pair_of(int z, int l) const {
    Pair pair{q_.covariance[3 * z], q_.covariance[3 * z + 1], q_.covariance[3 * z + 2],
              q_.map_covariance[3 * l], q_.map_covariance[3 * l + 1], q_.map_covariance[3 * l + 2],
              q_.map_points[2 * l], q_.map_points[2 * l + 1], q_.beta_p, 0.0,
              q_.pole_log_gain[z] + log_hit_[l] + log_scale_};
    const double width_error = (q_.pole_width[z] - q_.map_width[l]) / q_.width_sd;
    if (!std::isnan(width_error)) {
      pair.width_fit = -0.5 * width_error * width_error;
      pair.constant += q_.log_width_gain;
    }
    return pair;
  }

  // The optimal assignment of one pose of the block.
  void settle(int b, std::ptrdiff_t pose, const Output& out) {
    edges_.clear();
    fit_of_edge_.clear();
    for (std::size_t p = 0; p < pairs_.size(); ++p) {
      const double gain = gain_[p * kBlock + b] -
                          price_[static_cast<std::size_t>(pairs_[p].column) * kBlock + b];
      if (gain > 0.0) {
        edges_.push_back({pairs_[p].row, pairs_[p].column, -gain});
        fit_of_edge_.push_back(fit_[p * kBlock + b]);
      }
    }
    double cost = 0.0;
    int count = 0;
    assigner_.solve(edges_, alone_.data(), q_.poles, q_.landmarks, &cost, match_.data(), &count);
    double fit = 0.0;
    for (std::size_t edge = 0; edge < edges_.size(); ++edge)
      if (match_[edges_[edge].row] == edges_[edge].column) fit += fit_of_edge_[edge];
    out.log_likelihood[pose] = base_[b] - cost;
    out.log_fit[pose] = fit;
    out.expected[pose] = hoped_for_[b];
    out.matched[pose] = count;
    if (out.assignment != nullptr)
      std::copy(match_.begin(), match_.end(), out.assignment + pose * q_.poles);
  }

  const Problem& q_;
  std::vector<double> log_miss_, log_hit_, radius_, alone_;
  std::vector<int> match_;
  std::vector<double> free_range2_, pole_x_, pole_y_, price_, gain_, fit_;
  std::vector<Edge> pairs_, edges_;
  std::vector<double> fit_of_edge_;
  Assigner assigner_;
  Block block_;
  Lane range2_, bearing_, base_, hoped_for_;
  double log_scale_ = 0.0;
};

}  // namespace assignment
