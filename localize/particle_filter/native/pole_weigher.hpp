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

constexpr double kAhead = kPi / 2 - 1e-6;

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
      // whole vectors; one that is not full repeats its last pose
      lanes_ = std::min(kBlock, (count + kVector - 1) / kVector * kVector);
      for (int b = 0; b < lanes_; ++b) {
        const double* pose = poses + 3 * (first + std::min(b, count - 1));
        block_.east[b] = pose[0];
        block_.north[b] = pose[1];
        block_.cosine[b] = b < count ? std::cos(pose[2]) : block_.cosine[b - 1];
        block_.sine[b] = b < count ? std::sin(pose[2]) : block_.sine[b - 1];
      }
      look();
      pair_up();
      const bool greedy = out.assignment == nullptr && choose();
      for (int b = 0; b < count; ++b) {
        if (!greedy || greedy_.clash[b] != 0) {
          settle(b, first + b, out);
          continue;
        }
        // every row has its best column to itself: no assignment is worth more
        out.log_likelihood[first + b] = base_[b] - greedy_.cost[b];
        out.log_fit[first + b] = greedy_.fit[b];
        out.expected[first + b] = hoped_for_[b];
        out.matched[first + b] = static_cast<std::int32_t>(greedy_.matched[b]);
      }
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
    const Sight sight{view.bearing_min,
                      view.bins / (view.bearing_max - view.bearing_min),
                      view.range_min * view.range_min,
                      *std::max_element(free_range2_.begin(), free_range2_.end()),
                      free_range2_.data(),
                      view.bins};
    // a sector within less than a right angle to either side holds nothing behind the sensor
    const bool forward = view.bearing_min > -kAhead && view.bearing_max < kAhead;
    const double least_x = forward ? 0.0 : -kInfinity;
    for (int l = 0; l < q_.landmarks; ++l) {
      double* price = &price_[static_cast<std::size_t>(l) * kBlock];
      if (!local_block(block_, lanes_, q_.map_points[2 * l], q_.map_points[2 * l + 1],
                       view.origin_x, view.origin_y, sight.nearest2, sight.farthest2, least_x,
                       ahead_, left_, range2_)) {
        std::fill(price, price + kBlock, 0.0);
        continue;
      }
      bearing_block(lanes_, ahead_, left_, bearing_);
      price_block(sight, lanes_, log_miss_[l], q_.detection[l], range2_, bearing_, price, hope_);
      add_block(lanes_, price, base_);
      add_block(lanes_, hope_, hoped_for_);
    }
  }

  // Gives every row of every pose its best column; false where there are too many columns to tell
  // whether two rows want the same.
  bool choose() {
    bit_of_column_.assign(q_.landmarks, 0);
    int columns = 0;
    for (const Edge& pair : pairs_) {
      std::uint64_t& bit = bit_of_column_[pair.column];
      if (bit != 0) continue;
      if (columns == 64) return false;
      bit = std::uint64_t{1} << columns++;
    }
    greedy_ = Greedy{};
    for (std::size_t p = 0; p < pairs_.size();) {
      best_ = Best{};
      for (const int row = pairs_[p].row; p < pairs_.size() && pairs_[p].row == row; ++p) {
        const int column = pairs_[p].column;
        offer_block(lanes_, &gain_[p * kBlock], &price_[static_cast<std::size_t>(column) * kBlock],
                    &fit_[p * kBlock], bit_of_column_[column], &best_);
      }
      take_block(lanes_, best_, &greedy_);
    }
    return true;
  }

  // Lists the pairs that stand near enough for any pose of the block, and values them for all.
  void pair_up() {
    pairs_.clear();
    for (int z = 0; z < q_.poles; ++z) {
      double* x = &pole_x_[static_cast<std::size_t>(z) * kBlock];
      double* y = &pole_y_[static_cast<std::size_t>(z) * kBlock];
      place_block(block_, lanes_, q_.points[2 * z], q_.points[2 * z + 1], x, y);
      if (radius_[z] < 0.0) continue;
      const auto span_x = std::minmax_element(x, x + lanes_);
      const auto span_y = std::minmax_element(y, y + lanes_);
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
        pair_block(block_, lanes_, pair_of(z, l), x, y, &gain_[offset], &fit_[offset]);
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
  std::vector<std::uint64_t> bit_of_column_;
  int lanes_ = kBlock;
  Block block_;
  Best best_;
  Greedy greedy_;
  Lane ahead_, left_, range2_, bearing_, hope_, base_, hoped_for_;
  double log_scale_ = 0.0;
};

}  // namespace assignment
