// What the particle filter does to all particles at once, and to the small matrices of one scan.
//
// `move_along_arc` moves every particle as `motion_model.sample_motion` does, sum by sum in the
// same order, so that both give the same bits where products and sums are not fused; `add_scan` is
// the update of `persistent_errors.PersistentErrors`.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

namespace py = pybind11;

namespace {

using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Integers = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>;
constexpr double kPi = 3.14159265358979323846;

void check(bool right, const char* name) {
  if (!right) throw std::invalid_argument(std::string(name) + " has the wrong shape");
}

py::array_t<double> move_along_arc(const Doubles& rear, const Doubles& noise, const Doubles& slips,
                                   const Doubles& speed_share, const Doubles& rate_error,
                                   double dt_s, double arc_speed, double arc_rate,
                                   double speed_sd, double rate_sd, double turn_sd,
                                   double left_sd) {
  check(rear.ndim() == 2 && rear.shape(1) == 3, "rear");
  const py::ssize_t n = rear.shape(0);
  check(noise.ndim() == 2 && noise.shape(0) == 4 && noise.shape(1) == n, "noise");
  check(slips.size() == n, "slips");
  check(speed_share.size() == n, "speed_share");
  check(rate_error.size() == n, "rate_error");
  py::array_t<double> out({n, py::ssize_t{3}});
  const double *pose = rear.data(), *draw = noise.data(), *slip = slips.data();
  const double *share = speed_share.data(), *error = rate_error.data();
  double* moved = out.mutable_data();
  const double lateral = arc_speed * arc_rate;
  {
    py::gil_scoped_release release;
    for (py::ssize_t i = 0; i < n; ++i) {
      const double speed = arc_speed + speed_sd * draw[i] + share[i] * arc_speed;
      const double rate = arc_rate + rate_sd * draw[n + i] + error[i];
      const double turn = dt_s * rate;
      const double left = left_sd * draw[3 * n + i];
      const double half = 0.5 * turn;
      // sin(half) / half, with the detour of numpy's sinc
      double angle = kPi * (half / kPi);
      if (angle == 0.0) angle = std::numeric_limits<double>::epsilon();
      const double chord = speed * dt_s * (std::sin(angle) / angle);
      const double yaw = pose[3 * i + 2];
      const double way = yaw + half + -slip[i] * lateral;
      const double c = std::cos(way), s = std::sin(way);
      moved[3 * i] = pose[3 * i] + (chord * c - left * s);
      moved[3 * i + 1] = pose[3 * i + 1] + (chord * s + left * c);
      moved[3 * i + 2] = yaw + half + half + turn_sd * draw[2 * n + i];
    }
  }
  return out;
}

struct Symmetric {
  double xx, xy, yy;
};

// Lower Cholesky root in place of an (n, n) matrix, row by row.
void factor(std::vector<double>* matrix, int n) {
  std::vector<double>& a = *matrix;
  for (int j = 0; j < n; ++j) {
    for (int i = j; i < n; ++i) {
      double sum = a[i * n + j];
      for (int k = 0; k < j; ++k) sum -= a[i * n + k] * a[j * n + k];
      if (i > j) {
        a[i * n + j] = sum / a[j * n + j];
      } else if (sum > 0.0) {
        a[j * n + j] = std::sqrt(sum);
      } else {
        throw std::invalid_argument("a covariance is not positive definite");
      }
    }
  }
}

void solve(const std::vector<double>& root, int n, double* values) {
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < i; ++k) values[i] -= root[i * n + k] * values[k];
    values[i] /= root[i * n + i];
  }
  for (int i = n - 1; i >= 0; --i) {
    for (int k = i + 1; k < n; ++k) values[i] -= root[k * n + i] * values[k];
    values[i] /= root[i * n + i];
  }
}

// (3, columns) after `kept` (3, 3).
std::vector<double> kept_of(const double* kept, const double* values, int columns) {
  std::vector<double> out(3 * columns, 0.0);
  for (int r = 0; r < 3; ++r)
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < columns; ++c) out[r * columns + c] += kept[3 * r + k] * values[k * columns + c];
  return out;
}

py::tuple add_scan(const Doubles& particles, const Doubles& covariance, const Doubles& poles,
                   const Doubles& points, const Doubles& seen_covariance,
                   const Doubles& map_covariance, const Integers& columns, double yaw,
                   double floor_m2, double share, double lasting_share) {
  check(particles.ndim() == 2 && particles.shape(0) == 3 && particles.shape(1) == 3, "particles");
  check(covariance.ndim() == 2 && covariance.shape(0) == 3 && covariance.shape(1) == 3,
        "covariance");
  check(points.ndim() == 2 && points.shape(1) == 2, "points");
  const int count = static_cast<int>(points.shape(0)), size = 2 * count;
  check(poles.ndim() == 2 && poles.shape(0) == 3, "poles");
  check(seen_covariance.size() == 4 * count, "seen_covariance");
  check(map_covariance.size() == 3 * count, "map_covariance");
  check(columns.size() == count, "columns");
  const int width = static_cast<int>(poles.shape(1));
  for (int i = 0; i < count; ++i)
    check(columns.at(i) >= 0 && columns.at(i) + 1 < width, "columns");
  const double c = std::cos(yaw), s = std::sin(yaw);
  std::vector<Symmetric> seen(count), map(count);
  std::vector<std::array<double, 2>> arm(count);
  for (int i = 0; i < count; ++i) {
    const double* own = seen_covariance.data() + 4 * i;
    const double a = own[0] + floor_m2, b = own[1], d = own[3] + floor_m2;
    seen[i] = {c * c * a - 2.0 * c * s * b + s * s * d, c * s * (a - d) + (c * c - s * s) * b,
               s * s * a + 2.0 * c * s * b + c * c * d};
    const double* m = map_covariance.data() + 3 * i;
    map[i] = {m[0], m[2], m[1]};
    const double* p = points.data() + 2 * i;
    arm[i] = {c * p[0] - s * p[1], s * p[0] + c * p[1]};
  }
  // P H', three rows of 2 k
  const double* P = particles.data();
  std::vector<double> gain(3 * size), innovation(size * size);
  for (int r = 0; r < 3; ++r)
    for (int i = 0; i < count; ++i) {
      gain[r * size + 2 * i] = P[3 * r] - arm[i][1] * P[3 * r + 2];
      gain[r * size + 2 * i + 1] = P[3 * r + 1] + arm[i][0] * P[3 * r + 2];
    }
  for (int i = 0; i < count; ++i)
    for (int j = 0; j < size; ++j) {
      innovation[2 * i * size + j] = gain[j] - arm[i][1] * gain[2 * size + j];
      innovation[(2 * i + 1) * size + j] = gain[size + j] + arm[i][0] * gain[2 * size + j];
    }
  for (int i = 0; i < count; ++i) {
    const int one = 2 * i * size + 2 * i, two = one + size;
    innovation[one] += (seen[i].xx + map[i].xx) / share;
    innovation[one + 1] += (seen[i].xy + map[i].xy) / share;
    innovation[two] += (seen[i].xy + map[i].xy) / share;
    innovation[two + 1] += (seen[i].yy + map[i].yy) / share;
  }
  factor(&innovation, size);
  for (int r = 0; r < 3; ++r) solve(innovation, size, &gain[r * size]);
  // I - K H
  py::array_t<double> kept_out({3, 3}), covariance_out({3, 3});
  double* kept = kept_out.mutable_data();
  for (int r = 0; r < 3; ++r) {
    const double* k = &gain[r * size];
    double east = 0.0, north = 0.0, turn = 0.0;
    for (int i = 0; i < count; ++i) {
      east += k[2 * i];
      north += k[2 * i + 1];
      turn += k[2 * i + 1] * arm[i][0] - k[2 * i] * arm[i][1];
    }
    kept[3 * r] = (r == 0) - east;
    kept[3 * r + 1] = (r == 1) - north;
    kept[3 * r + 2] = (r == 2) - turn;
  }
  const std::vector<double> led = kept_of(kept, poles.data(), width);
  std::vector<double> moved(3 * width, 0.0);
  double added[9] = {};
  for (int i = 0; i < count; ++i) {
    const Symmetric& q = seen[i];
    const double xx = lasting_share * q.xx + map[i].xx, xy = lasting_share * q.xy + map[i].xy;
    const double yy = lasting_share * q.yy + map[i].yy;
    const double root = std::sqrt(xx), low = xy / root, rest = yy - low * low;
    if (!(xx > 0.0 && rest > 0.0))
      throw std::invalid_argument("a covariance is not positive definite");
    const double corner = std::sqrt(rest), white = (1.0 - lasting_share) / share;
    const py::ssize_t first = columns.at(i);
    for (int r = 0; r < 3; ++r) {
      const double g = gain[r * size + 2 * i], h = gain[r * size + 2 * i + 1];
      moved[r * width + first] += g * root + h * low;
      moved[r * width + first + 1] += h * corner;
      for (int t = 0; t < 3; ++t) {
        const double u = gain[t * size + 2 * i], v = gain[t * size + 2 * i + 1];
        added[3 * r + t] += white * (g * (q.xx * u + q.xy * v) + h * (q.xy * u + q.yy * v));
      }
    }
  }
  const std::vector<double> half = kept_of(kept, covariance.data(), 3);
  py::array_t<double> poles_out({3, width});
  double *after = covariance_out.mutable_data(), *left = poles_out.mutable_data();
  for (int r = 0; r < 3; ++r)
    for (int t = 0; t < 3; ++t) {
      double sum = added[3 * r + t];
      for (int k = 0; k < 3; ++k) sum += half[3 * r + k] * kept[3 * t + k];
      for (int j = 0; j < width; ++j) {
        const double m = moved[r * width + j], n = moved[t * width + j];
        sum += m * n - led[r * width + j] * n - m * led[t * width + j];
      }
      after[3 * r + t] = sum;
    }
  for (int r = 0; r < 3; ++r)
    for (int t = r + 1; t < 3; ++t)
      after[3 * r + t] = after[3 * t + r] = 0.5 * (after[3 * r + t] + after[3 * t + r]);
  for (int j = 0; j < 3 * width; ++j) left[j] = led[j] - moved[j];
  return py::make_tuple(kept_out, covariance_out, poles_out);
}

}  // namespace

PYBIND11_MODULE(particle_kernel, module) {
  module.doc() = "Motion of all particles; errors that last after a scan.";
  module.def("move_along_arc", &move_along_arc, py::arg("rear"), py::arg("noise"),
             py::arg("slips"), py::arg("speed_share"), py::arg("rate_error"), py::arg("dt_s"),
             py::arg("arc_speed"), py::arg("arc_rate"), py::arg("speed_sd"), py::arg("rate_sd"),
             py::arg("turn_sd"), py::arg("left_sd"));
  module.def("add_scan", &add_scan, py::arg("particles"), py::arg("covariance"),
             py::arg("poles"), py::arg("points"), py::arg("seen_covariance"),
             py::arg("map_covariance"), py::arg("columns"), py::arg("yaw"), py::arg("floor_m2"),
             py::arg("share"), py::arg("lasting_share"));
}
