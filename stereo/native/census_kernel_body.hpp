// The hot loops of census SGM. Included once for each instruction set, with KERNEL_NAMESPACE,
// KERNEL_TARGET and KERNEL_BYTES (the width of its registers) set. Most are plain loops over kLanes
// bytes that the compiler turns into vectors; where values must stay in registers over a loop over
// the disparities, the compilers' portable vector types say so.
//
// Names: x column, y row, d disparity index (disparity minus offset). A path cost is
//   L(x, d) = C(x, d) + min(L'(d), L'(d-1) + P1, L'(d+1) + P1, m' + P2) - m'
// where L' belongs to the predecessor on the path and m' is its minimum over d. What exceeds C is
// at most P2, so the excesses of three paths fit one byte: that is what the volumes hold, a row as
// blocks of kLanes columns, a block as disparities x kLanes.

namespace census {
namespace KERNEL_NAMESPACE {

#define KERNEL_FN KERNEL_TARGET __attribute__((noinline)) static
#define KERNEL_INLINE KERNEL_TARGET static inline __attribute__((always_inline))

#include "kernel_views.hpp"
#include "kernel_costs.hpp"
#include "kernel_vertical.hpp"
#include "kernel_horizontal.hpp"
#include "kernel_winners.hpp"
#include "kernel_passes.hpp"
#include "kernel_checks.hpp"

#undef KERNEL_FN
#undef KERNEL_INLINE

}  // namespace KERNEL_NAMESPACE
}  // namespace census
