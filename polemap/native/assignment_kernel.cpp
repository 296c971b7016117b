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

// arctan of t in [0, 1], odd polynomial around the two halves; |error| < 1e-10, no branches left
inline double small_arctan(double t) {
  constexpr double tan_eighth = 0.41421356237309503;
  const bool upper = t > tan_eighth;
  const double x = upper ? (t - 1.0) / (t + 1.0) : t;
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
  const double t = largest > 0.0 ? smallest / largest : 0.0;
  double angle = small_arctan(t);
  angle = ay > ax ? kPi / 2 - angle : angle;
  angle = x < 0.0 ? kPi - angle : angle;
  return y < 0.0 ? -angle : angle;
}

struct View {
  double origin_x, origin_y, bearing_min, bearing_max, range_min;
  const double* free_range;
  int bins;
};

// Range and bearing of every landmark from the sensor of one pose.
MULTIVERSION
void bearings(int landmarks, const double* map_x, const double* map_y, double sensor_x,
              double sensor_y, double cosine, double sine, double* range, double* bearing) {
  for (int l = 0; l < landmarks; ++l) {
    const double dx = map_x[l] - sensor_x;
    const double dy = map_y[l] - sensor_y;
    const double x = cosine * dx + sine * dy;
    const double y = cosine * dy - sine * dx;
    range[l] = std::sqrt(x * x + y * y);
    bearing[l] = fast_atan2(y, x);
  }
}

// Marks the pairs that stand near enough to be worth a look; rows are padded to `stride` bytes.
MULTIVERSION
void coarse_gate(int poles, int landmarks, int stride, const double* pole_x, const double* pole_y,
                 const double* radius2, const double* map_x, const double* map_y,
                 std::uint8_t* mask) {
  for (int z = 0; z < poles; ++z) {
    const double x = pole_x[z];
    const double y = pole_y[z];
    const double limit = radius2[z];
    std::uint8_t* row = mask + static_cast<std::size_t>(z) * stride;
    for (int l = 0; l < landmarks; ++l) {
      const double dx = map_x[l] - x;
      const double dy = map_y[l] - y;
      row[l] = dx * dx + dy * dy <= limit ? 1 : 0;
    }
  }
}

struct Problem {
  int poles, landmarks;
  const double *points, *covariance, *pole_width, *pole_log_gain;             // of the scan
  const double *map_points, *map_covariance, *map_width, *detection;          // of the map
  double beta_p, width_sd, log_width_gain;
  View view;
};

// Likelihoods of the poses begin..end-1.
void weigh(const Problem& q, const double* poses, py::ssize_t begin, py::ssize_t end,
           double* log_likelihood, double* log_fit, double* expected, std::int32_t* matched,
           std::int32_t* assignment) {
  const int stride = (q.landmarks + 7) / 8 * 8;
  std::vector<double> map_x(q.landmarks), map_y(q.landmarks), log_miss(q.landmarks),
      log_hit(q.landmarks), price(q.landmarks), range(q.landmarks), bearing(q.landmarks),
      pole_x(q.poles),
      pole_y(q.poles), radius2(q.poles), alone(q.poles, 0.0);
  std::vector<std::uint8_t> mask(static_cast<std::size_t>(q.poles) * stride, 0);
  std::vector<Edge> edges;
  std::vector<double> fit_of_edge;
  std::vector<int> match(q.poles);
  Assigner assigner;
  double largest_map_variance = 0.0;
  double best_hit = -kInfinity;
  for (int l = 0; l < q.landmarks; ++l) {
    map_x[l] = q.map_points[2 * l];
    map_y[l] = q.map_points[2 * l + 1];
    log_miss[l] = std::log1p(-q.detection[l]);
    log_hit[l] = std::log(q.detection[l]);
    largest_map_variance =
        std::max(largest_map_variance, q.map_covariance[3 * l] + q.map_covariance[3 * l + 1]);
    best_hit = std::max(best_hit, log_hit[l] - log_miss[l]);
  }
  const double log_scale = std::log(q.beta_p) - std::log(2.0 * kPi);
  for (int z = 0; z < q.poles; ++z) {
    // beyond this distance even the best landmark is worth less than no match
    const double xx = q.covariance[3 * z], yy = q.covariance[3 * z + 1], xy = q.covariance[3 * z + 2];
    const double gain = q.pole_log_gain[z] + best_hit + log_scale +
                        std::max(0.0, q.log_width_gain) - 0.5 * std::log(xx * yy - xy * xy);
    radius2[z] = gain > 0.0 ? 2.0 * gain * (xx + yy + largest_map_variance) / q.beta_p : -1.0;
  }
  double longest_view = 0.0;
  for (int k = 0; k < q.view.bins; ++k)
    longest_view = std::max(longest_view, q.view.free_range[k]);
  const double bins_per_rad =
      q.view.bins > 0 ? q.view.bins / (q.view.bearing_max - q.view.bearing_min) : 0.0;

  for (py::ssize_t i = begin; i < end; ++i) {
    const double east = poses[3 * i], north = poses[3 * i + 1];
    const double c = std::cos(poses[3 * i + 2]), s = std::sin(poses[3 * i + 2]);
    double log_weight = 0.0;
    double hoped_for = 0.0;
    if (q.view.bins > 0) {
      bearings(q.landmarks, map_x.data(), map_y.data(),
               east + c * q.view.origin_x - s * q.view.origin_y,
               north + s * q.view.origin_x + c * q.view.origin_y, c, s, range.data(),
               bearing.data());
      for (int l = 0; l < q.landmarks; ++l) {
        bool inside = range[l] >= q.view.range_min && range[l] <= longest_view;
        if (inside) {
          const double column = (bearing[l] - q.view.bearing_min) * bins_per_rad;
          inside = column >= 0.0 && column < q.view.bins &&
                   range[l] <= q.view.free_range[static_cast<int>(column)];
        }
        price[l] = 0.0;
        if (inside) {
          // the edge of the range is no wall: a miss says less the nearer to it
          const double ratio = range[l] / longest_view;
          const double fade = 1.0 - ratio * ratio;
          price[l] = fade * log_miss[l];
          log_weight += price[l];
          hoped_for += fade * q.detection[l];
        }
      }
    } else {
      std::fill(price.begin(), price.end(), 0.0);
    }
    for (int z = 0; z < q.poles; ++z) {
      pole_x[z] = east + c * q.points[2 * z] - s * q.points[2 * z + 1];
      pole_y[z] = north + s * q.points[2 * z] + c * q.points[2 * z + 1];
    }
    coarse_gate(q.poles, q.landmarks, stride, pole_x.data(), pole_y.data(), radius2.data(),
                map_x.data(), map_y.data(), mask.data());
    edges.clear();
    fit_of_edge.clear();
    for (int z = 0; z < q.poles; ++z) {
      const std::uint8_t* row = &mask[static_cast<std::size_t>(z) * stride];
      const double xx = q.covariance[3 * z], yy = q.covariance[3 * z + 1], xy = q.covariance[3 * z + 2];
      // the scan's covariance turned into the map
      const double cc = c * c, ss = s * s, cs = c * s;
      const double ee = cc * xx - 2.0 * cs * xy + ss * yy;
      const double nn = ss * xx + 2.0 * cs * xy + cc * yy;
      const double en = cs * (xx - yy) + (cc - ss) * xy;
      for (int l = 0; l < q.landmarks; ++l) {
        if (!row[l]) continue;
        const double a = ee + q.map_covariance[3 * l];
        const double b = nn + q.map_covariance[3 * l + 1];
        const double d = en + q.map_covariance[3 * l + 2];
        const double determinant = a * b - d * d;
        const double dx = map_x[l] - pole_x[z], dy = map_y[l] - pole_y[z];
        const double mahalanobis2 = (b * dx * dx - 2.0 * d * dx * dy + a * dy * dy) / determinant;
        double fit = -0.5 * q.beta_p * mahalanobis2;
        double gain = q.pole_log_gain[z] + log_hit[l] + log_scale - 0.5 * std::log(determinant);
        const double width_error = (q.pole_width[z] - q.map_width[l]) / q.width_sd;
        if (!std::isnan(width_error)) {
          fit -= 0.5 * width_error * width_error;
          gain += q.log_width_gain;
        }
        gain += fit - price[l];
        if (gain > 0.0) {
          edges.push_back({z, l, -gain});
          fit_of_edge.push_back(fit);
        }
      }
    }
    double cost = 0.0;
    int count = 0;
    assigner.solve(edges, alone.data(), q.poles, q.landmarks, &cost, match.data(), &count);
    log_likelihood[i] = log_weight - cost;
    double fit = 0.0;
    for (std::size_t edge = 0; edge < edges.size(); ++edge)
      if (match[edges[edge].row] == edges[edge].column) fit += fit_of_edge[edge];
    log_fit[i] = fit;
    matched[i] = count;
    expected[i] = hoped_for;
    if (assignment != nullptr)
      std::copy(match.begin(), match.end(), assignment + i * q.poles);
  }
}

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
  double* weight = log_likelihood.mutable_data();
  double* fit = log_fit.mutable_data();
  std::int32_t* matches = matched.mutable_data();
  double* hoped_for = expected.mutable_data();
  std::int32_t* pairs = want_assignment ? assignment.mutable_data() : nullptr;
  {
    py::gil_scoped_release release;
    const int workers = static_cast<int>(std::max<py::ssize_t>(1, std::min<py::ssize_t>(threads, n)));
    std::vector<std::thread> pool;
    for (int worker = 1; worker < workers; ++worker)
      pool.emplace_back([&, worker] {
        weigh(problem, pose, n * worker / workers, n * (worker + 1) / workers, weight, fit,
              hoped_for, matches, pairs);
      });
    weigh(problem, pose, 0, n / workers, weight, fit, hoped_for, matches, pairs);
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
