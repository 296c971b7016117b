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
#include <exception>
#include <initializer_list>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "assigner.hpp"
#include "pole_weigher.hpp"

namespace py = pybind11;

namespace {

using assignment::Assigner;
using assignment::Edge;
using assignment::kInfinity;
using assignment::Output;
using assignment::Problem;
using assignment::View;
using assignment::Weigher;
using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;

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
    std::vector<std::exception_ptr> errors(workers);
    const auto weigh = [&](py::ssize_t worker) {
      try {
        Weigher(problem).weigh(pose, n * worker / workers, n * (worker + 1) / workers, out);
      } catch (...) {
        errors[worker] = std::current_exception();
      }
    };
    std::vector<std::thread> pool;
    for (py::ssize_t worker = 1; worker < workers; ++worker) pool.emplace_back(weigh, worker);
    weigh(0);
    for (std::thread& thread : pool) thread.join();
    for (const std::exception_ptr& error : errors)
      if (error) std::rethrow_exception(error);
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
