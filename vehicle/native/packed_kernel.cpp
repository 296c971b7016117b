// The CTRV filter's prediction and its Joseph update by one scalar, on packed tuples of floats.
//
// Written out as in `vehicle/packed.py`, sum by sum in the same order: the two give the same bits
// where the compiler does not fuse products and sums.

#include <pybind11/pybind11.h>

#include <array>
#include <cmath>
#include <stdexcept>

namespace py = pybind11;

namespace {

constexpr int kSize = 9, kUpper = 45;
constexpr double kPi = 3.14159265358979323846;
using Mean = std::array<double, kSize>;
using Upper = std::array<double, kUpper>;

template <std::size_t count>
std::array<double, count> numbers_of(const py::handle& tuple, const char* name) {
  if (!PyTuple_Check(tuple.ptr()) || PyTuple_GET_SIZE(tuple.ptr()) < static_cast<int>(count))
    throw std::invalid_argument(std::string(name) + " is no tuple of " + std::to_string(count) +
                                " numbers");
  std::array<double, count> values;
  for (std::size_t i = 0; i < count; ++i) {
    values[i] = PyFloat_AsDouble(PyTuple_GET_ITEM(tuple.ptr(), i));
    if (values[i] == -1.0 && PyErr_Occurred() != nullptr) throw py::error_already_set();
  }
  return values;
}

template <std::size_t count>
py::object tuple_of(const std::array<double, count>& values) {
  PyObject* tuple = PyTuple_New(count);
  if (tuple == nullptr) throw py::error_already_set();
  for (std::size_t i = 0; i < count; ++i) {
    PyObject* value = PyFloat_FromDouble(values[i]);
    if (value == nullptr) {
      Py_DECREF(tuple);
      throw py::error_already_set();
    }
    PyTuple_SET_ITEM(tuple, i, value);
  }
  return py::reinterpret_steal<py::object>(tuple);
}

// To [-pi, pi), with the remainder as Python takes it.
double wrap(double angle) {
  if (-kPi <= angle && angle < kPi) return angle;
  double rest = std::fmod(angle + kPi, 2.0 * kPi);
  if (rest < 0.0) rest += 2.0 * kPi;
  return rest - kPi;
}

struct Noise {
  double acceleration, yaw_acceleration, slip, along, yaw, turn;
  double scale_sd, scale_s, offset_sd, offset_s, fix_sd, fix_s;
};

Noise noise_of(const py::tuple& noise) {
  const auto plain = numbers_of<6>(noise, "noise");
  if (noise.size() != 9) throw std::invalid_argument("noise has not nine entries");
  const auto scale = numbers_of<2>(noise[6], "scale");
  const auto offset = numbers_of<2>(noise[7], "offset");
  const auto fix = numbers_of<2>(noise[8], "fix");
  return {plain[0], plain[1], plain[2], plain[3],  plain[4],  plain[5],
          scale[0], scale[1], offset[0], offset[1], fix[0], fix[1]};
}

// `f(x)`, `F P F' + Q`.
void predict(Mean* mean, const Upper& p, double dt_s, const Noise& noise, double slip, Upper* out) {
  const double x = (*mean)[0], y = (*mean)[1], yaw = (*mean)[2], v = (*mean)[3], w = (*mean)[4];
  const double half = 0.5 * w * dt_s;
  const double h2 = half * half;
  double ratio, slope;
  if (h2 < 2.5e-3) {
    ratio = 1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0 * (1.0 - h2 / 72.0)));
    slope = -half / 3.0 * (1.0 - h2 / 10.0 * (1.0 - h2 / 28.0 * (1.0 - h2 / 54.0)));
  } else {
    ratio = std::sin(half) / half;
    slope = (half * std::cos(half) - std::sin(half)) / h2;
  }
  const double way = yaw + half - slip * v * w;
  const double c = std::cos(way), s = std::sin(way);
  const double length = v * dt_s;
  const double chord = length * ratio;
  // rows of the transition F: x by (yaw, v, w) is (a, b, g); y by the same is (d, e, f)
  const double a = -chord * s, b = dt_s * ratio * c + slip * w * chord * s;
  const double d = chord * c, e = dt_s * ratio * s - slip * w * chord * c;
  const double g = 0.5 * dt_s * (length * slope * c - chord * s) + slip * v * chord * s;
  const double f = 0.5 * dt_s * (length * slope * s + chord * c) - slip * v * chord * c;
  const double p00 = p[0], p01 = p[1], p02 = p[2], p03 = p[3], p04 = p[4], p05 = p[5], p06 = p[6],
      p07 = p[7], p08 = p[8], p11 = p[9], p12 = p[10], p13 = p[11], p14 = p[12], p15 =
      p[13], p16 = p[14], p17 = p[15], p18 = p[16], p22 = p[17], p23 = p[18], p24 = p[19],
      p25 = p[20], p26 = p[21], p27 = p[22], p28 = p[23], p33 = p[24], p34 = p[25], p35 =
      p[26], p36 = p[27], p37 = p[28], p38 = p[29], p44 = p[30], p45 = p[31], p46 = p[32],
      p47 = p[33], p48 = p[34], p55 = p[35], p56 = p[36], p57 = p[37], p58 = p[38], p66 =
      p[39], p67 = p[40], p68 = p[41], p77 = p[42], p78 = p[43], p88 = p[44];
  // what is kept of the Gauss-Markov errors
  const double i = std::exp(-dt_s / noise.scale_s), j = std::exp(-dt_s / noise.offset_s);
  const double k = std::exp(-dt_s / noise.fix_s);
  const double fix_m2 = (1.0 - k * k) * noise.fix_sd * noise.fix_sd;
  const double r00 = p00 + a * p02 + b * p03 + g * p04;
  const double r01 = p01 + a * p12 + b * p13 + g * p14;
  const double r02 = p02 + a * p22 + b * p23 + g * p24;
  const double r03 = p03 + a * p23 + b * p33 + g * p34;
  const double r04 = p04 + a * p24 + b * p34 + g * p44;
  const double r11 = p11 + d * p12 + e * p13 + f * p14;
  const double r12 = p12 + d * p22 + e * p23 + f * p24;
  const double r13 = p13 + d * p23 + e * p33 + f * p34;
  const double r14 = p14 + d * p24 + e * p34 + f * p44;
  const double r22 = p22 + dt_s * p24;
  const double r23 = p23 + dt_s * p34;
  const double r24 = p24 + dt_s * p44;
  // what white accelerations add along (u) and across (n) the path, to yaw and yaw rate
  const double qa = noise.acceleration, qw = noise.yaw_acceleration;
  const double dt2 = dt_s * dt_s, dt3 = dt2 * dt_s, v2 = v * v;
  const double quu = qa * dt3 / 3.0 + noise.along * v2 * dt_s;
  const double quv = qa * dt2 / 2.0;
  const double qnn = qw * v2 * dt2 * dt3 / 20.0 + noise.slip * (v2 * w) * (v2 * w) * dt_s;
  const double qny = qw * v * dt2 * dt2 / 8.0;
  const double qnw = qw * v * dt3 / 6.0;
  const double qyy = qw * dt3 / 3.0;
  const double qyw = qw * dt2 / 2.0;
  const double drift = (noise.yaw * (v2 < 1.0 ? v2 : 1.0) + noise.turn * w * w) * dt_s;
  Upper& q = *out;
  q[0] = r00 + a * r02 + b * r03 + g * r04 + c * c * quu + s * s * qnn;
  q[1] = r01 + d * r02 + e * r03 + f * r04 + c * s * (quu - qnn);
  q[2] = r02 + dt_s * r04 - s * qny;
  q[3] = r03 + c * quv;
  q[4] = r04 - s * qnw;
  q[5] = i * (p05 + a * p25 + b * p35 + g * p45);
  q[6] = j * (p06 + a * p26 + b * p36 + g * p46);
  q[7] = k * (p07 + a * p27 + b * p37 + g * p47);
  q[8] = k * (p08 + a * p28 + b * p38 + g * p48);
  q[9] = r11 + d * r12 + e * r13 + f * r14 + s * s * quu + c * c * qnn;
  q[10] = r12 + dt_s * r14 + c * qny;
  q[11] = r13 + s * quv;
  q[12] = r14 + c * qnw;
  q[13] = i * (p15 + d * p25 + e * p35 + f * p45);
  q[14] = j * (p16 + d * p26 + e * p36 + f * p46);
  q[15] = k * (p17 + d * p27 + e * p37 + f * p47);
  q[16] = k * (p18 + d * p28 + e * p38 + f * p48);
  q[17] = r22 + dt_s * r24 + qyy + drift;
  q[18] = r23;
  q[19] = r24 + qyw;
  q[20] = i * (p25 + dt_s * p45);
  q[21] = j * (p26 + dt_s * p46);
  q[22] = k * (p27 + dt_s * p47);
  q[23] = k * (p28 + dt_s * p48);
  q[24] = p33 + noise.acceleration * dt_s;
  q[25] = p34;
  q[26] = i * p35;
  q[27] = j * p36;
  q[28] = k * p37;
  q[29] = k * p38;
  q[30] = p44 + noise.yaw_acceleration * dt_s;
  q[31] = i * p45;
  q[32] = j * p46;
  q[33] = k * p47;
  q[34] = k * p48;
  q[35] = i * i * p55 + (1.0 - i * i) * noise.scale_sd * noise.scale_sd;
  q[36] = i * j * p56;
  q[37] = i * k * p57;
  q[38] = i * k * p58;
  q[39] = j * j * p66 + (1.0 - j * j) * noise.offset_sd * noise.offset_sd;
  q[40] = j * k * p67;
  q[41] = j * k * p68;
  q[42] = k * k * p77 + fix_m2;
  q[43] = k * k * p78;
  q[44] = k * k * p88 + fix_m2;
  *mean = {x + chord * c, y + chord * s, wrap(yaw + half + half), v, w,
           i * (*mean)[5], j * (*mean)[6], k * (*mean)[7], k * (*mean)[8]};
}

py::tuple ctrv_predict(const py::tuple& mean, const py::tuple& upper, double dt_s,
                       const py::tuple& noise, double slip) {
  Mean state = numbers_of<kSize>(mean, "mean");
  Upper out;
  predict(&state, numbers_of<kUpper>(upper, "upper"), dt_s, noise_of(noise), slip, &out);
  return py::make_tuple(tuple_of(state), tuple_of(out));
}

// Where entry (row, column) stands in the upper triangle.
int number(int row, int column) {
  const int i = row < column ? row : column, j = row < column ? column : row;
  return i * kSize - i * (i - 1) / 2 + j - i;
}

// (I - k h') P (I - k h')' + k r k', with P h' = p and s = h p + r
py::tuple update_by_two(const py::tuple& mean, const py::tuple& upper, const py::tuple& row,
                        double residual, double variance) {
  Mean state = numbers_of<kSize>(mean, "mean");
  Upper u = numbers_of<kUpper>(upper, "upper");
  const auto [one, h_first, two, h_second] = numbers_of<4>(row, "row");
  const int first = static_cast<int>(one), second = static_cast<int>(two);
  if (first < 0 || first >= kSize || second < 0 || second >= kSize)
    throw std::invalid_argument("row names an entry that the state does not have");
  Mean p, k;
  for (int i = 0; i < kSize; ++i)
    p[i] = h_first * u[number(first, i)] + h_second * u[number(second, i)];
  const double s = h_first * p[first] + h_second * p[second] + variance;
  if (s == 0.0) {
    PyErr_SetString(PyExc_ZeroDivisionError, "float division by zero");
    throw py::error_already_set();
  }
  for (int i = 0; i < kSize; ++i) k[i] = p[i] / s;
  int entry = 0;
  for (int i = 0; i < kSize; ++i)
    for (int j = i; j < kSize; ++j, ++entry)
      u[entry] = u[entry] - k[i] * p[j] - p[i] * k[j] + k[i] * k[j] * s;
  for (int i = 0; i < kSize; ++i) state[i] += k[i] * residual;
  state[2] = wrap(state[2]);
  return py::make_tuple(tuple_of(state), tuple_of(u));
}

// The same by two measurements at once, each of `variance`: with P H' = B and S = H B + r I.
py::tuple update_by_pair(const py::tuple& mean, const py::tuple& upper, const py::tuple& row_one,
                         const py::tuple& row_two, double residual_one, double residual_two,
                         double variance) {
  Mean state = numbers_of<kSize>(mean, "mean");
  Upper u = numbers_of<kUpper>(upper, "upper");
  const Mean one = numbers_of<kSize>(row_one, "row_one");
  const Mean two = numbers_of<kSize>(row_two, "row_two");
  Mean a{}, b{}, k, l;
  double s00 = variance, s01 = 0.0, s11 = variance;
  for (int i = 0; i < kSize; ++i) {
    for (int j = 0; j < kSize; ++j) {
      const double p = u[number(i, j)];
      a[i] += p * one[j];
      b[i] += p * two[j];
    }
    s00 += one[i] * a[i];
    s01 += one[i] * b[i];
    s11 += two[i] * b[i];
  }
  // eliminated, not by the determinant: after an hour without a fix its products cancel
  const double share = s01 / s00, rest = s11 - share * s01;
  if (!(s00 > 0.0 && rest > 0.0))
    throw std::invalid_argument("innovation covariance is not positive definite");
  for (int i = 0; i < kSize; ++i) {
    l[i] = (b[i] - share * a[i]) / rest;
    k[i] = a[i] / s00 - share * l[i];
  }
  // (I - K H) P (I - K H)' + K R K', in full: the short form goes negative for large covariances
  std::array<Mean, kSize> keep{}, half{};
  for (int i = 0; i < kSize; ++i) {
    for (int j = 0; j < kSize; ++j)
      keep[i][j] = (i == j ? 1.0 : 0.0) - k[i] * one[j] - l[i] * two[j];
    for (int j = 0; j < kSize; ++j)
      for (int m = 0; m < kSize; ++m) half[i][j] += keep[i][m] * u[number(m, j)];
  }
  int entry = 0;
  for (int i = 0; i < kSize; ++i) {
    for (int j = i; j < kSize; ++j, ++entry) {
      double sum = variance * (k[i] * k[j] + l[i] * l[j]);
      for (int m = 0; m < kSize; ++m) sum += half[i][m] * keep[j][m];
      u[entry] = sum;
    }
    state[i] += k[i] * residual_one + l[i] * residual_two;
  }
  state[2] = wrap(state[2]);
  const double second = residual_two - share * residual_one;
  const double nis = residual_one * residual_one / s00 + second * second / rest;
  return py::make_tuple(nis, tuple_of(state), tuple_of(u));
}

}  // namespace

PYBIND11_MODULE(packed_kernel, module) {
  module.doc() = "Prediction and update of the CTRV filter on packed tuples.";
  module.def("ctrv_predict", &ctrv_predict, py::arg("mean"), py::arg("upper"), py::arg("dt_s"),
             py::arg("noise"), py::arg("slip") = 0.0);
  module.def("update_by_two", &update_by_two, py::arg("mean"), py::arg("upper"), py::arg("row"),
             py::arg("residual"), py::arg("variance"));
  module.def("update_by_pair", &update_by_pair, py::arg("mean"), py::arg("upper"),
             py::arg("row_one"), py::arg("row_two"), py::arg("residual_one"),
             py::arg("residual_two"), py::arg("variance"));
}
