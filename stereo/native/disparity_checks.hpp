// What is done to finished disparity maps: small components go.
#pragma once

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "census_kernel.hpp"

namespace census {

// Removes connected components (four neighbours, disparity steps of at most `step_px`) that have
// fewer than `least_px` pixels, unless they reach over `tall_rows` rows: a thin pole is small but
// tall, a wrong match is small and low.
class SpeckleFilter {
 public:
  void run(float* map, int width, int height, int least_px, int tall_rows, float step_px) {
    if (least_px <= 1) return;
    components_.clear();
    components_.push_back({0, 0, 0, 0});  // what has no disparity
    labels_.resize(static_cast<std::size_t>(width) * height);
    left_.resize(round_up(width, kLanes));
    above_.resize(round_up(width, kLanes));
    for (int y = 0; y < height; ++y) label_row(map, width, y, step_px);
    keep_.assign(components_.size(), 1);
    for (std::uint32_t label = 1; label < components_.size(); ++label) {
      const Component& root = components_[find(label)];
      keep_[label] = root.size >= least_px || root.last_row - root.first_row + 1 >= tall_rows;
    }
    const std::size_t size = static_cast<std::size_t>(width) * height;
    const std::uint32_t* labels = labels_.get();
    const float gone = __builtin_nanf("");
    for (std::size_t i = 0; i < size; ++i) map[i] = keep_[labels[i]] != 0 ? map[i] : gone;
  }

 private:
  struct Component {
    std::uint32_t parent;
    int size, first_row, last_row;
  };

  std::uint32_t find(std::uint32_t label) {
    while (components_[label].parent != label) {
      components_[label].parent = components_[components_[label].parent].parent;
      label = components_[label].parent;
    }
    return label;
  }

  void join(std::uint32_t one, std::uint32_t other) {
    one = find(one);
    other = find(other);
    if (one == other) return;
    if (other < one) std::swap(one, other);  // the older one has the smaller first row
    Component& root = components_[one];
    root.size += components_[other].size;
    root.last_row = std::max(root.last_row, components_[other].last_row);
    components_[other].parent = one;
  }

  // Runs of one row become components, and join those of the row above that they touch.
  void label_row(const float* map, int width, int y, float step_px) {
    const float* row = map + static_cast<std::size_t>(y) * width;
    const float* up = y > 0 ? row - width : row;
    std::uint32_t* labels = labels_.get() + static_cast<std::size_t>(y) * width;
    const std::uint32_t* labels_up = y > 0 ? labels - width : labels;
    u8* left = left_.get();
    u8* above = above_.get();
    left[0] = 0;
    for (int x = 1; x < width; ++x) left[x] = __builtin_fabsf(row[x] - row[x - 1]) <= step_px;
    for (int x = 0; x < width; ++x) above[x] = __builtin_fabsf(row[x] - up[x]) <= step_px;
    std::uint32_t label = 0, joined = 0;
    bool fresh = true;  // nothing of the row above joined to this run yet
    for (int x = 0; x < width; ++x) {
      labels[x] = 0;
      if (row[x] != row[x]) continue;
      if (!left[x]) {
        label = static_cast<std::uint32_t>(components_.size());
        components_.push_back({label, 0, y, y});
        fresh = true;
      }
      labels[x] = label;
      ++components_[label].size;
      if (y > 0 && above[x] && (fresh || labels_up[x] != joined)) {
        joined = labels_up[x];
        fresh = false;
        pending_.push_back({label, joined});
      }
    }
    // sizes are complete only now: a run must not move while it grows
    for (const auto& pair : pending_) join(pair[0], pair[1]);
    pending_.clear();
  }

  std::vector<Component> components_;
  std::vector<u8> keep_;
  std::vector<std::array<std::uint32_t, 2>> pending_;
  Buffer<std::uint32_t> labels_;
  Buffer<u8> left_, above_;
};

}  // namespace census
