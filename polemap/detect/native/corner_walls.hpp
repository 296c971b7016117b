// The wall at every upright edge, and what lies beside it: corner_surface.py says why.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace corners {

constexpr int kRowsMax = 32, kInMax = 16, kOutMax = 8;

struct Rules {
    int rows, row_step, height_px;
    double clear_px, highest_m, focal_baseline, free_m, slope_prior, shared;
    std::vector<double> inward, outward, above;
};

struct View {
    const float *left, *right;
    int height, width;

    float at(const float* map, double u, double v) const {
        const double column = std::nearbyint(u), row = std::nearbyint(v);
        if (!(column >= 0.0 && column < width && row >= 0.0 && row < height)) return 0.0f;
        return map[static_cast<size_t>(row) * width + static_cast<size_t>(column)];
    }
};

struct Plane {
    double a, k, m;
};

struct Normal {
    double n00 = 0, n01 = 0, n02 = 0, n11 = 0, n12 = 0, n22 = 0, r0 = 0, r1 = 0, r2 = 0;

    void add(double u, double v, double d) {
        n00 += 1.0;
        n01 += u;
        n02 += v;
        n11 += u * u;
        n12 += u * v;
        n22 += v * v;
        r0 += d;
        r1 += u * d;
        r2 += v * d;
    }

    // few samples say nothing of a slope: the wall is upright, and the edge's disparity holds
    void hold(double prior, double d) {
        const double trace = n00 + 1.0;
        n00 += 0.5;
        n11 += 1e-3 * trace;
        n22 += prior * trace * 100.0;
        r0 += 0.5 * d;
    }

    double minor() const { return n11 * n22 - n12 * n12; }
    double determinant() const {
        return n00 * minor() - n01 * (n01 * n22 - n12 * n02) + n02 * (n01 * n12 - n11 * n02);
    }

    Plane solved() const {
        const double all = determinant();
        return {(r0 * minor() - n01 * (r1 * n22 - n12 * r2) + n02 * (r1 * n12 - n11 * r2)) / all,
                (n00 * (r1 * n22 - n12 * r2) - r0 * (n01 * n22 - n12 * n02) +
                 n02 * (n01 * r2 - r1 * n02)) / all,
                (n00 * (n11 * r2 - r1 * n12) - n01 * (n01 * r2 - r1 * n02) +
                 r0 * (n01 * n12 - n11 * n02)) / all};
    }
};

struct WallOut {
    double *table;  // (6, n): a, k, m, rms, sd, over
    bool *on, *nearer, *seen, *inside, *free, *beside, *blank;
    std::ptrdiff_t n;
};

class Wall {
  public:
    Wall(const Rules& set, const View& view, const double* edge) : set_(set), view_(view) {
        column_ = edge[0];
        row_ = edge[1];
        slope_ = edge[2];
        top_ = edge[3];
        bottom_ = edge[4];
        d_ = edge[5];
        free_ = edge[6];
        per_m_ = edge[7];
        foot_ = edge[8];
        in_ = static_cast<int>(set.inward.size());
        out_ = static_cast<int>(set.outward.size());
        middle_ = 0.5 * (top_ + bottom_);
        for (int i = 0; i < in_; ++i) offset_[i] = (set.clear_px + set.inward[i] * per_m_) * -free_;
    }

    void sample() {
        const double top = std::max(top_, foot_ - set_.highest_m * per_m_);
        const double bottom = std::max(std::min(bottom_, foot_ - 0.15 * per_m_), top);
        for (int h = 0; h < set_.rows; ++h) {
            rows_[h] = top + (bottom - top) * ((h + 0.5) / set_.rows);
            const double line = column_ + slope_ * (rows_[h] - row_), v = rows_[h] / set_.row_step;
            for (int i = 0; i < in_; ++i)
                own_[h][i] = view_.at(view_.left, line + offset_[i], v);
            for (int o = 0; o < out_; ++o) {
                // beside a left flank the right map sees the background up to the edge
                double beyond = line + free_ * (set_.clear_px + set_.outward[o] * per_m_);
                if (free_ < 0.0) beyond -= d_;
                away_[h][o] = view_.at(free_ < 0.0 ? view_.right : view_.left, beyond, v);
            }
        }
    }

    void fit() {
        plane_ = {d_, first_slope(), 0.0};
        const double tolerance = 0.7 + 0.03 * d_;
        for (int sweep = 0; sweep < 3; ++sweep) {
            normal_ = Normal();
            const double limit = (sweep == 0 ? 1.6 : 1.0) * tolerance;
            for (int h = 0; h < set_.rows; ++h) {
                const double v = rows_[h] - middle_;
                for (int i = 0; i < in_; ++i) {
                    const double value = own_[h][i];
                    const double rest = value - expected(offset_[i], v);
                    on_[h][i] = value > 0.0 && std::abs(rest) <= limit;
                    if (on_[h][i]) normal_.add(offset_[i], v, value);
                }
            }
            count_ = static_cast<int>(normal_.n00);
            normal_.hold(set_.slope_prior, d_);
            if (sweep < 2) plane_ = normal_.solved();
        }
    }

    void write(const WallOut& out, std::ptrdiff_t n) const {
        const double tolerance = 0.7 + 0.03 * d_;
        double squares = 0.0;
        for (int h = 0; h < set_.rows; ++h) {
            const double v = rows_[h] - middle_;
            const std::ptrdiff_t row = n * set_.rows + h;
            out.inside[row] = rows_[h] >= 0.0 && rows_[h] < set_.height_px;
            for (int i = 0; i < in_; ++i) {
                const double rest = own_[h][i] - expected(offset_[i], v);
                const bool seen = own_[h][i] > 0.0;
                if (on_[h][i]) squares += rest * rest;
                out.on[row * in_ + i] = on_[h][i];
                out.seen[row * in_ + i] = seen;
                out.nearer[row * in_ + i] = seen && rest > tolerance;
            }
            const double edge = plane_.a + plane_.m * v;
            const double step = std::max(set_.free_m * edge * edge / set_.focal_baseline, 0.8);
            for (int o = 0; o < out_; ++o) {
                const bool measured = away_[h][o] > 0.0;
                out.free[row * out_ + o] = measured && away_[h][o] < edge - step;
                out.beside[row * out_ + o] = measured && away_[h][o] >= edge - step;
                out.blank[row * out_ + o] = !measured;
            }
        }
        const double rms = std::sqrt(squares / std::max(count_, 1));
        const double inverse = normal_.minor() / normal_.determinant();
        double* table = out.table + n;
        table[0 * out.n] = plane_.a;
        table[1 * out.n] = plane_.k;
        table[2 * out.n] = plane_.m;
        table[3 * out.n] = rms;
        table[4 * out.n] = std::sqrt(std::max(inverse, 0.0) * set_.shared) * (rms + 0.1);
        table[5 * out.n] = over(tolerance);
    }

  private:
    double expected(double u, double v) const { return plane_.a + plane_.k * u + plane_.m * v; }

    // share of the samples over the top that show the wall
    double over(double tolerance) const {
        int on = 0;
        for (const double above_m : set_.above) {
            const double row = top_ - above_m * per_m_;
            const double line = column_ + slope_ * (row - row_);
            for (int i = 0; i < in_; ++i) {
                const double value = view_.at(view_.left, line + offset_[i], row / set_.row_step);
                on += value > 0.0 && std::abs(value - expected(offset_[i], row - middle_)) <= tolerance;
            }
        }
        return on / static_cast<double>(set_.above.size() * in_);
    }

    // a wall may end soon, so its first slope is that of the near offsets
    double first_slope() const {
        double slopes[4];
        int good = 0;
        for (int i = 1; i < 5; ++i) {
            double values[kRowsMax];
            int count = 0;
            for (int h = 0; h < set_.rows; ++h)
                if (own_[h][i] > 0.0) values[count++] = own_[h][i];
            if (count < 3) continue;
            const int middle = (count - 1) / 2;
            std::nth_element(values, values + middle, values + count);
            slopes[good++] = (values[middle] - d_) / offset_[i];
        }
        if (!good) return 0.0;
        std::nth_element(slopes, slopes + (good - 1) / 2, slopes + good);
        return slopes[(good - 1) / 2];
    }

    const Rules& set_;
    const View& view_;
    double column_, row_, slope_, top_, bottom_, d_, free_, per_m_, foot_, middle_;
    int in_, out_, count_ = 0;
    double offset_[kInMax], rows_[kRowsMax], own_[kRowsMax][kInMax], away_[kRowsMax][kOutMax];
    bool on_[kRowsMax][kInMax];
    Plane plane_{};
    Normal normal_;
};

}  // namespace corners
