// Optimal one-to-one assignment of seen poles to map poles, for many poses at once.
//
// Two doors: `assign_batch` solves b independent assignment problems, `pole_log_likelihood` builds
// the problem of every pose (particle) itself, so that no (poses, poles, landmarks) array exists.
// Both gate first, split what is left into connected components, settle the trivial ones directly
// and run the shortest augmenting path method of Jonker and Volgenant on the others.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace py = pybind11;

// One binary, the widest vector unit of the machine that runs it: the loader picks the clone.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__linux__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define MULTIVERSION __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define MULTIVERSION
#endif

namespace {

using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kPi = 3.14159265358979323846;
constexpr int kFree = -1;

struct Edge {
  int row;
  int column;
  double cost;
};

// Solves one sparse assignment problem at a time; its buffers are reused from problem to problem.
class Assigner {
 public:
  // Minimises the cost of the chosen edges plus `unassigned[row]` of every row left alone.
  // Returns false if a row can neither be matched nor left alone. `match` receives the column of
  // every row, or kFree; `matched` counts the rows that have one.
  bool solve(const std::vector<Edge>& edges, const double* unassigned, int rows, int columns,
             double* total, int* match, int* matched) {
    row_degree_.assign(rows, 0);
    column_degree_.assign(columns, 0);
    std::fill(match, match + rows, kFree);
    bool simple = true;
    for (const Edge& edge : edges) {
      simple &= ++row_degree_[edge.row] == 1;
      simple &= ++column_degree_[edge.column] == 1;
    }
    if (simple) {
      for (const Edge& edge : edges) match[edge.row] = edge.column;
      return sum(edges, unassigned, rows, total, match, matched);
    }
    split(edges, rows, columns);
    for (int component = 0; component < components_; ++component) {
      const int r = static_cast<int>(rows_of_[component].size());
      if (r == 1) {
        solve_row(edges, unassigned, component, match);
      } else if (!solve_component(edges, unassigned, component, match)) {
        return false;
      }
    }
    return sum(edges, unassigned, rows, total, match, matched);
  }

 private:
  bool sum(const std::vector<Edge>& edges, const double* unassigned, int rows, double* total,
           const int* match, int* matched) {
    double cost = 0.0;
    int count = 0;
    for (const Edge& edge : edges)
      if (match[edge.row] == edge.column) cost += edge.cost;
    for (int row = 0; row < rows; ++row) {
      if (match[row] == kFree) {
        cost += unassigned[row];
      } else {
        ++count;
      }
    }
    *total = cost;
    *matched = count;
    return cost < kInfinity;
  }

  int find(int node) {
    while (parent_[node] != node) node = parent_[node] = parent_[parent_[node]];
    return node;
  }

  // Connected components of the bipartite graph: rows are nodes 0..rows-1, columns follow.
  void split(const std::vector<Edge>& edges, int rows, int columns) {
    parent_.resize(rows + columns);
    for (int node = 0; node < rows + columns; ++node) parent_[node] = node;
    for (const Edge& edge : edges) {
      const int a = find(edge.row);
      const int b = find(rows + edge.column);
      if (a != b) parent_[std::max(a, b)] = std::min(a, b);
    }
    label_.assign(rows + columns, kFree);
    local_.assign(rows + columns, 0);
    components_ = 0;
    for (int node = 0; node < rows + columns; ++node) {
      const bool is_row = node < rows;
      if ((is_row ? row_degree_[node] : column_degree_[node - rows]) == 0) continue;
      const int root = find(node);
      if (label_[root] == kFree) {
        label_[root] = components_++;
        if (static_cast<int>(rows_of_.size()) < components_) {
          rows_of_.resize(components_);
          columns_of_.resize(components_);
          edges_of_.resize(components_);
        }
        rows_of_[label_[root]].clear();
        columns_of_[label_[root]].clear();
        edges_of_[label_[root]].clear();
      }
      std::vector<int>& members = is_row ? rows_of_[label_[root]] : columns_of_[label_[root]];
      local_[node] = static_cast<int>(members.size());
      members.push_back(is_row ? node : node - rows);
    }
    for (std::size_t index = 0; index < edges.size(); ++index)
      edges_of_[label_[find(edges[index].row)]].push_back(static_cast<int>(index));
    first_column_ = rows;
  }

  void solve_row(const std::vector<Edge>& edges, const double* unassigned, int component,
                 int* match) {
    const int row = rows_of_[component][0];
    double best = unassigned[row];
    for (const int index : edges_of_[component]) {
      if (edges[index].cost < best) {
        best = edges[index].cost;
        match[row] = edges[index].column;
      }
    }
  }

  // Jonker and Volgenant (1987), augmentation by shortest paths, on a dense matrix that has one
  // private column a row for "left alone".
  bool solve_component(const std::vector<Edge>& edges, const double* unassigned, int component,
                       int* match) {
    const std::vector<int>& rows = rows_of_[component];
    const std::vector<int>& columns = columns_of_[component];
    const int r = static_cast<int>(rows.size());
    const int real = static_cast<int>(columns.size());
    const int c = real + r;
    cost_.assign(static_cast<std::size_t>(r) * c, kInfinity);
    for (const int index : edges_of_[component]) {
      const Edge& edge = edges[index];
      double& cell = cost_[static_cast<std::size_t>(local_[edge.row]) * c +
                           local_[first_column_ + edge.column]];
      cell = std::min(cell, edge.cost);
    }
    for (int i = 0; i < r; ++i)
      cost_[static_cast<std::size_t>(i) * c + real + i] = unassigned[rows[i]];
    u_.assign(r, 0.0);
    v_.assign(c, 0.0);
    column_of_row_.assign(r, kFree);
    row_of_column_.assign(c, kFree);
    for (int row = 0; row < r; ++row)
      if (!augment(row, r, c)) return false;
    for (int i = 0; i < r; ++i)
      match[rows[i]] = column_of_row_[i] < real ? columns[column_of_row_[i]] : kFree;
    return true;
  }

  bool augment(int first, int r, int c) {
    shortest_.assign(c, kInfinity);
    path_.assign(c, kFree);
    row_seen_.assign(r, 0);
    column_seen_.assign(c, 0);
    int row = first;
    int sink = kFree;
    double distance = 0.0;
    while (sink == kFree) {
      row_seen_[row] = 1;
      const double* costs = &cost_[static_cast<std::size_t>(row) * c];
      double lowest = kInfinity;
      int nearest = kFree;
      for (int j = 0; j < c; ++j) {
        if (column_seen_[j]) continue;
        const double through = distance + costs[j] - u_[row] - v_[j];
        if (through < shortest_[j]) {
          shortest_[j] = through;
          path_[j] = row;
        }
        // among equals a free column ends the search at once
        if (shortest_[j] < lowest ||
            (shortest_[j] == lowest && nearest != kFree && row_of_column_[j] == kFree)) {
          lowest = shortest_[j];
          nearest = j;
        }
      }
      if (nearest == kFree) return false;
      distance = lowest;
      column_seen_[nearest] = 1;
      if (row_of_column_[nearest] == kFree) {
        sink = nearest;
      } else {
        row = row_of_column_[nearest];
      }
    }
    u_[first] += distance;
    for (int i = 0; i < r; ++i)
      if (row_seen_[i] && i != first) u_[i] += distance - shortest_[column_of_row_[i]];
    for (int j = 0; j < c; ++j)
      if (column_seen_[j]) v_[j] -= distance - shortest_[j];
    int column = sink;
    while (true) {
      const int i = path_[column];
      row_of_column_[column] = i;
      std::swap(column_of_row_[i], column);
      if (i == first) return true;
    }
  }

  std::vector<int> row_degree_, column_degree_, parent_, label_, local_;
  std::vector<std::vector<int>> rows_of_, columns_of_, edges_of_;
  std::vector<double> cost_, u_, v_, shortest_;
  std::vector<int> path_, column_of_row_, row_of_column_;
  std::vector<char> row_seen_, column_seen_;
  int components_ = 0;
  int first_column_ = 0;
};

py::tuple assign_batch(const Doubles& costs, const Doubles& unassigned) {
  if (costs.ndim() != 3) throw std::invalid_argument("costs must have the shape (b, r, c)");
  const auto batch = costs.shape(0);
  const int rows = static_cast<int>(costs.shape(1));
  const int columns = static_cast<int>(costs.shape(2));
  if (unassigned.ndim() != 2 || unassigned.shape(0) != batch || unassigned.shape(1) != rows)
    throw std::invalid_argument("unassigned must have the shape (b, r)");
  py::array_t<double> totals(batch);
  py::array_t<std::int32_t> matches({batch, static_cast<py::ssize_t>(rows)});
  const double* cost = costs.data();
  const double* alone = unassigned.data();
  double* total = totals.mutable_data();
  std::int32_t* match = matches.mutable_data();
  py::ssize_t bad_value = -1;
  py::ssize_t infeasible = -1;
  {
    py::gil_scoped_release release;
    Assigner assigner;
    std::vector<Edge> edges;
    std::vector<int> chosen(rows);
    for (py::ssize_t b = 0; b < batch && bad_value < 0 && infeasible < 0; ++b) {
      edges.clear();
      for (int i = 0; i < rows; ++i) {
        const double limit = alone[b * rows + i];
        if (std::isnan(limit) || limit == -kInfinity) bad_value = b;
        for (int j = 0; j < columns; ++j) {
          const double value = cost[(b * rows + i) * columns + j];
          if (std::isnan(value) || value == -kInfinity) bad_value = b;
          // a pair that is no better than leaving the row alone can always be left out
          if (value < limit) edges.push_back({i, j, value});
        }
      }
      if (bad_value >= 0) break;
      int matched = 0;
      if (!assigner.solve(edges, alone + b * rows, rows, columns, &total[b], chosen.data(),
                          &matched))
        infeasible = b;
      std::copy(chosen.begin(), chosen.end(), match + b * rows);
    }
  }
  if (bad_value >= 0)
    throw std::invalid_argument("problem " + std::to_string(bad_value) +
                                " has a cost that is NaN or minus infinity");
  if (infeasible >= 0)
    throw std::invalid_argument("problem " + std::to_string(infeasible) +
                                " has no assignment of finite cost");
  return py::make_tuple(totals, matches);
}

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

struct View {
  double origin_x, origin_y, bearing_min, bearing_max, range_min;
  const double* free_range;
  int bins;
};

// Particles are weighed in blocks: neighbours see nearly the same, so they share the gating, and
// every loop runs over the block, where the compiler vectorises it.
constexpr int kBlock = 64;
using Lane = double[kBlock];

struct Block {
  Lane east, north, cosine, sine;
};

// Squared range and bearing of one landmark from the sensor of every pose of a block.
MULTIVERSION
void sight_block(const Block& block, double map_x, double map_y, double origin_x, double origin_y,
                 double* range2, double* bearing) {
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
void place_block(const Block& block, double x, double y, double* map_x, double* map_y) {
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
void pair_block(const Block& block, const Pair& pair, const double* pole_x, const double* pole_y,
                double* gain, double* fit) {
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

struct Problem {
  int poles, landmarks;
  const double *points, *covariance, *pole_width, *pole_log_gain;  // of the scan
  const double *map_points, *map_covariance, *map_width, *detection;  // of the map
  double beta_p, width_sd, log_width_gain;
  View view;
};

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

  void weigh(const double* poses, py::ssize_t begin, py::ssize_t end, const Output& out) {
    for (py::ssize_t first = begin; first < end; first += kBlock) {
      const int count = static_cast<int>(std::min<py::ssize_t>(kBlock, end - first));
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
  void settle(int b, py::ssize_t pose, const Output& out) {
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

void check(const Doubles& array, std::initializer_list<py::ssize_t> shape, const char* name,
           bool finite) {
  bool same = array.ndim() == static_cast<py::ssize_t>(shape.size());
  py::ssize_t axis = 0;
  for (const py::ssize_t length : shape) {
    if (same && length >= 0 && array.shape(axis) != length) same = false;
    ++axis;
  }
  if (!same) throw std::invalid_argument(std::string(name) + " has the wrong shape");
  if (!finite) return;
  const double* data = array.data();
  for (py::ssize_t i = 0; i < array.size(); ++i)
    if (!std::isfinite(data[i]))
      throw std::invalid_argument(std::string(name) + " holds a value that is not finite");
}

py::tuple pole_log_likelihood(const Doubles& poses, const Doubles& points,
                              const Doubles& covariance, const Doubles& pole_width,
                              const Doubles& pole_log_gain, const Doubles& map_points,
                              const Doubles& map_covariance, const Doubles& map_width,
                              const Doubles& detection, const Doubles& view,
                              const Doubles& free_range, double beta_p, double width_sd,
                              double log_width_gain, bool want_assignment, int threads) {
  check(poses, {-1, 3}, "poses", true);
  check(points, {-1, 2}, "points", true);
  check(map_points, {-1, 2}, "map_points", true);
  const py::ssize_t z = points.shape(0), m = map_points.shape(0), n = poses.shape(0);
  check(covariance, {z, 3}, "covariance", true);
  check(pole_width, {z}, "pole_width", false);
  check(pole_log_gain, {z}, "pole_log_gain", true);
  check(map_covariance, {m, 3}, "map_covariance", true);
  check(map_width, {m}, "map_width", false);
  check(detection, {m}, "detection", true);
  check(view, {5}, "view", true);
  check(free_range, {-1}, "free_range", true);
  Problem problem{static_cast<int>(z), static_cast<int>(m), points.data(), covariance.data(),
                  pole_width.data(), pole_log_gain.data(), map_points.data(),
                  map_covariance.data(), map_width.data(), detection.data(), beta_p, width_sd,
                  log_width_gain,
                  View{view.at(0), view.at(1), view.at(2), view.at(3), view.at(4),
                       free_range.data(), static_cast<int>(free_range.size())}};
  py::array_t<double> log_likelihood(n), log_fit(n), expected(n);
  py::array_t<std::int32_t> matched(n);
  py::array_t<std::int32_t> assignment({want_assignment ? n : 0, z});
  const double* pose = poses.data();
  const Output out{log_likelihood.mutable_data(), log_fit.mutable_data(), expected.mutable_data(),
                   matched.mutable_data(),
                   want_assignment ? assignment.mutable_data() : nullptr};
  {
    py::gil_scoped_release release;
    const py::ssize_t workers = std::max<py::ssize_t>(1, std::min<py::ssize_t>(threads, n));
    std::vector<std::thread> pool;
    for (py::ssize_t worker = 1; worker < workers; ++worker)
      pool.emplace_back([&, worker] {
        Weigher(problem).weigh(pose, n * worker / workers, n * (worker + 1) / workers, out);
      });
    Weigher(problem).weigh(pose, 0, n / workers, out);
    for (std::thread& thread : pool) thread.join();
  }
  return py::make_tuple(log_likelihood, log_fit, expected, matched, assignment);
}

}  // namespace

PYBIND11_MODULE(assignment_kernel, module) {
  module.doc() = "Batched optimal assignment of seen poles to map poles.";
  module.def("assign_batch", &assign_batch, py::arg("costs"), py::arg("unassigned"));
  module.def("pole_log_likelihood", &pole_log_likelihood, py::arg("poses"), py::arg("points"),
             py::arg("covariance"), py::arg("pole_width"), py::arg("pole_log_gain"),
             py::arg("map_points"), py::arg("map_covariance"), py::arg("map_width"),
             py::arg("detection"), py::arg("view"), py::arg("free_range"), py::arg("beta_p"),
             py::arg("width_sd"), py::arg("log_width_gain"), py::arg("want_assignment") = false,
             py::arg("threads") = 1);
}
