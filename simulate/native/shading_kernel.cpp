// The light that reaches the camera along each ray: texture, sun, sky, shadow and mirrored sky.
//
// One pass over the rays instead of some forty over arrays. It computes what the class
// `PlainShader` of simulate/shading.py computes, which serves where this is not built and is the
// oracle of its tests; texture look-ups differ by the 1/32 texel to which OpenCV rounds.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <vector>

namespace py = pybind11;

namespace {

using Floats = py::array_t<float, py::array::c_style>;
using Bytes = py::array_t<std::uint8_t, py::array::c_style>;
using Ints = py::array_t<std::int32_t, py::array::c_style>;
using Words = py::array_t<std::uint16_t, py::array::c_style>;
using Triangles = py::array_t<std::uint32_t, py::array::c_style>;

constexpr int kLevels = 8;
constexpr int kTilePx = 512;
constexpr float kAlbedoStep = 1.0f / 40000.0f;
constexpr float kBiasM = 0.04f, kBiasCells = 1.2f, kLargestBiasM = 0.8f;
constexpr float kTranslucent = 0.5f;
constexpr std::int32_t kSky = -1;

struct Vec {
  float x, y, z;
};

float dot(const Vec& a, const Vec& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Without SSE 4.1, which is not everywhere, std::floor is a call.
int floor_of(float x) {
  const int cut = static_cast<int>(x);
  return cut - (x < static_cast<float>(cut));
}

// The value of a picture between its four pixels around (x, y).
template <typename T>
float bilinear(const T* pixels, int stride, float x, float y) {
  const int left = floor_of(x), top = floor_of(y);
  const float fx = x - static_cast<float>(left), fy = y - static_cast<float>(top);
  const T* at = pixels + static_cast<std::ptrdiff_t>(top) * stride + left;
  const float above = at[0] + fx * (static_cast<float>(at[1]) - at[0]);
  const float below = at[stride] + fx * (static_cast<float>(at[stride + 1]) - at[stride]);
  return above + fy * (below - above);
}

// What the Python side says of the light; see simulate/lighting.py.
struct Light {
  Vec to_sun;
  float sun, ambient, glare, cloudiness;
  bool dusk;
};

struct ShadowMap {
  const float* distance_m = nullptr;
  int rows = 0, columns = 0;
  Vec axes[3];
  float corner[2], cell_m;

  // Share of the sunlight that passes what stands still.
  float lit(const Vec& p, float cosine) const {
    const float grazing = std::sqrt(std::max(1.0f - cosine * cosine, 0.0f)) / cosine;
    const float bias = std::min(kBiasM + kBiasCells * cell_m * grazing, kLargestBiasM);
    const float x = (dot(p, axes[0]) - corner[0]) / cell_m - 0.5f;
    const float y = (dot(p, axes[1]) - corner[1]) / cell_m - 0.5f;
    const float height = dot(p, axes[2]);
    float share = 0.0f;
    for (const float shift : {-0.3f, 0.3f}) {
      const int column = floor_of(x + shift + 0.5f), row = floor_of(y + shift + 0.5f);
      const bool outside = column < 0 || row < 0 || column >= columns || row >= rows;
      const auto cell = static_cast<std::ptrdiff_t>(row) * columns + column;
      if (outside || height > distance_m[cell] - bias) share += 0.5f;
    }
    return share;
  }
};

class Shader {
 public:
  Shader(Words atlas, Floats corners, Bytes leafy, Floats gloss, int macro, int foliage,
         Floats clouds, py::dict light, py::object shadow_map, float focal_px)
      : atlas_(std::move(atlas)), corners_(std::move(corners)), leafy_(std::move(leafy)),
        gloss_(std::move(gloss)), clouds_(std::move(clouds)), macro_(macro), foliage_(foliage),
        per_focal_(1.0f / focal_px) {
    tiles_ = static_cast<int>(leafy_.size());
    if (corners_.size() != 2 * kLevels * tiles_ || gloss_.size() != tiles_)
      throw std::invalid_argument("tables of the atlas do not fit together");
    const auto sun = light["to_sun"].cast<Floats>();
    light_ = {{sun.at(0), sun.at(1), sun.at(2)}, light["sun"].cast<float>(),
              light["ambient"].cast<float>(), light["glare"].cast<float>(),
              light["cloudiness"].cast<float>(), light["dusk"].cast<bool>()};
    if (shadow_map.is_none()) return;
    distance_ = shadow_map.attr("distance_m").cast<Floats>();
    const auto axes = shadow_map.attr("axes").cast<Floats>();
    const auto corner = shadow_map.attr("corner_m").cast<Floats>();
    shadow_.distance_m = distance_.data();
    shadow_.rows = static_cast<int>(distance_.shape(0));
    shadow_.columns = static_cast<int>(distance_.shape(1));
    for (int i = 0; i < 3; ++i) shadow_.axes[i] = {axes.at(i, 0), axes.at(i, 1), axes.at(i, 2)};
    shadow_.corner[0] = corner.at(0);
    shadow_.corner[1] = corner.at(1);
    shadow_.cell_m = shadow_map.attr("cell_m").cast<float>();
  }

  // Light, owner and leafiness of every ray, and what is still to be asked about the sun: the rows,
  // the rays to cast towards it, and the light to take away where something stands between.
  // `ask` is a box (x low, y low, x high, y high) of points to ask for, or empty for none.
  py::tuple shade(const Floats& surface, const Bytes& tile, const Ints& owner, const Floats& rays,
                  const Floats& depth, const Triangles& triangle, const Floats& bary,
                  const Floats& normal, const std::vector<float>& ask) const {
    const py::ssize_t n = depth.size(), m = tile.size();
    if (rays.size() != 6 * n || triangle.size() != n || bary.size() != 2 * n ||
        normal.size() != 3 * n || surface.size() != 8 * m || owner.size() != m)
      throw std::invalid_argument("rays, hits and mesh differ in length");
    Floats light(n);
    Ints owners(n);
    py::array_t<bool> leaves(n);
    float* out = light.mutable_data();
    std::int32_t* out_owner = owners.mutable_data();
    bool* out_leafy = leaves.mutable_data();
    std::vector<std::int64_t> rows;
    std::vector<float> to_sun, taken;
    {
      const py::gil_scoped_release release;
      const float *s = surface.data(), *r = rays.data(), *d = depth.data(), *b = bary.data(),
                  *nn = normal.data();
      for (py::ssize_t i = 0; i < n; ++i) {
        const Vec ray{r[6 * i + 3], r[6 * i + 4], r[6 * i + 5]};
        if (!std::isfinite(d[i])) {
          out[i] = sky(ray);
          out_owner[i] = kSky;
          out_leafy[i] = false;
          continue;
        }
        const std::uint32_t t = std::min<std::uint32_t>(triangle.data()[i], m - 1);
        const Hit hit{s + 8 * static_cast<std::size_t>(t), tile.data()[t], b + 2 * i,
                      {nn[3 * i], nn[3 * i + 1], nn[3 * i + 2]}, d[i]};
        const Vec from{r[6 * i], r[6 * i + 1], r[6 * i + 2]};
        Vec point;
        float sunlight;
        out[i] = one(hit, from, ray, &point, &sunlight);
        out_owner[i] = owner.data()[t];
        out_leafy[i] = leafy_.data()[hit.tile] != 0;
        if (!ask.empty() && sunlight > 0.0f && point.x > ask[0] && point.y > ask[1] &&
            point.x < ask[2] && point.y < ask[3]) {
          rows.push_back(i);
          taken.push_back(sunlight);
          to_sun.insert(to_sun.end(), {point.x, point.y, point.z, light_.to_sun.x, light_.to_sun.y,
                                       light_.to_sun.z});
        }
      }
    }
    const py::ssize_t asked = static_cast<py::ssize_t>(rows.size());
    return py::make_tuple(light, owners, leaves,
                          py::array_t<std::int64_t>(asked, rows.data()),
                          Floats({asked, py::ssize_t{6}}, to_sun.data()),
                          Floats(asked, taken.data()));
  }

 private:
  struct Hit {
    const float* surface;
    std::uint8_t tile;
    const float* bary;
    Vec normal;
    float depth;
  };

  float albedo(int tile, int level, float u, float v) const {
    const float* corner = corners_.data() + 2 * (level * tiles_ + tile);
    const float size = static_cast<float>(kTilePx >> level);
    const float x = (u - static_cast<float>(floor_of(u))) * size + corner[0];
    const float y = (v - static_cast<float>(floor_of(v))) * size + corner[1];
    return bilinear(atlas_.data(), static_cast<int>(atlas_.shape(1)), x, y) * kAlbedoStep;
  }

  float one(const Hit& hit, const Vec& from, const Vec& ray, Vec* point, float* sunlight) const {
    const float* s = hit.surface;
    const float u = s[0] + hit.bary[0] * s[2] + hit.bary[1] * s[4];
    const float v = s[1] + hit.bary[0] * s[3] + hit.bary[1] * s[5];
    const float facing = dot(hit.normal, ray), turn = facing > 0.0f ? -1.0f : 1.0f;
    const Vec normal{turn * hit.normal.x, turn * hit.normal.y, turn * hit.normal.z};
    const float reach = std::sqrt(dot(ray, ray));
    const float grazing = std::max(std::fabs(facing) / reach, 0.03f);
    const float footprint = hit.depth * s[7] / std::sqrt(grazing) * per_focal_;
    const float texels = std::min(std::max(footprint * (kTilePx * 1.41421f), 1.0f), 128.0f);
    std::int32_t bits;
    std::memcpy(&bits, &texels, sizeof bits);
    const int level = std::min((bits >> 23) - 127, kLevels - 1);
    float shade = albedo(hit.tile, level, u, v) * s[6];
    *point = {from.x + ray.x * hit.depth, from.y + ray.y * hit.depth, from.z + ray.z * hit.depth};
    const bool upright = std::fabs(normal.z) < 0.7f;
    const float across = (point->x + (upright ? 0.83f * point->y : 0.0f)) * 0.041f;
    const float up = (upright ? 1.7f * point->z : point->y) * 0.041f;
    shade *= 2.0f * albedo(macro_, 0, across, up);
    const float bare = shade * (light_.ambient * (0.55f + 0.45f * normal.z) +
                                0.03f * light_.sun * (1.0f - normal.z));
    *sunlight = shade * sun_on(hit.tile, normal, point);
    float out = bare + *sunlight;
    const float gloss = gloss_.data()[hit.tile];
    if (gloss > 0.0f) {
      const Vec unit{ray.x / reach, ray.y / reach, ray.z / reach};
      const float cosine = dot(unit, normal);
      const Vec mirrored{unit.x - 2 * cosine * normal.x, unit.y - 2 * cosine * normal.y,
                         unit.z - 2 * cosine * normal.z};
      const float low = 1.0f + cosine, square = low * low;
      const float share = gloss + (1.0f - gloss) * 0.7f * square * square * low;
      const float seen = albedo(foliage_, 2, mirrored.x * 0.6f, mirrored.y * 0.6f);
      out += share * sky(mirrored) * std::min(std::max(0.3f + 3.0f * seen, 0.0f), 2.0f);
    }
    return out;
  }

  // Sunlight on a surface; moves the point off its surface, from where shadows are asked for.
  float sun_on(int tile, const Vec& normal, Vec* point) const {
    const float facing = dot(normal, light_.to_sun);
    float cosine = facing;
    if (leafy_.data()[tile] != 0) cosine = std::max(cosine, -kTranslucent * cosine);
    if (cosine <= 0.0f || light_.sun == 0.0f) return 0.0f;
    point->x += 0.02f * normal.x;
    point->y += 0.02f * normal.y;
    point->z += 0.02f * normal.z;
    const float share = shadow_.distance_m != nullptr ? shadow_.lit(*point, std::fabs(facing)) : 1.0f;
    return light_.sun * cosine * share;
  }

  // A place in the picture of the clouds, which repeats.
  static float wrapped(float place) {
    constexpr float size = kTilePx - 2;
    const float x = place + 200.0f;
    return std::max(x - size * static_cast<float>(floor_of(x / size)), 0.0f);
  }

  float sky(const Vec& ray) const {
    const float length = std::sqrt(dot(ray, ray));
    const float rise = std::min(std::max(ray.z / length, 0.0f), 1.0f);
    float base = light_.ambient * light_.glare * (1.0f - 0.48f * std::sqrt(rise));
    if (light_.dusk) {
      const float toward = (ray.x * light_.to_sun.x + ray.y * light_.to_sun.y) / length;
      base *= (0.55f + 0.45f * std::min(std::max(toward, 0.0f), 1.0f)) * (1.0f - 0.5f * rise);
    }
    const float scale = 60.0f / (rise + 0.12f);
    const float cloud = bilinear(clouds_.data(), static_cast<int>(clouds_.shape(1)),
                                 wrapped(ray.x / length * scale), wrapped(ray.y / length * scale));
    return base * (1.0f + light_.cloudiness * cloud);
  }

  Words atlas_;
  Floats corners_;
  Bytes leafy_;
  Floats gloss_, clouds_, distance_;
  int macro_, foliage_, tiles_ = 0;
  float per_focal_;
  Light light_{};
  ShadowMap shadow_;
};

}  // namespace

PYBIND11_MODULE(shading_kernel, module) {
  module.doc() = "shading of ray-cast pictures (see simulate/shading.py)";
  py::class_<Shader>(module, "Shader")
      .def(py::init<Words, Floats, Bytes, Floats, int, int, Floats, py::dict, py::object, float>(),
           py::kw_only(), py::arg("atlas"), py::arg("corners"), py::arg("leafy"), py::arg("gloss"),
           py::arg("macro"), py::arg("foliage"), py::arg("clouds"), py::arg("light"),
           py::arg("shadow_map"), py::arg("focal_px"))
      .def("shade", &Shader::shade);
}
