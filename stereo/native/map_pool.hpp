// Memory of the arrays that go out to Python.
#pragma once

#include <cstddef>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include <pybind11/numpy.h>

#include "census_kernel.hpp"

namespace census {

// Arrays that come back here when Python has forgotten them: fresh memory would cost a page fault
// for every 4 KB of every map. Held by shared_ptr, since arrays may outlive the matcher.
class MapPool : public std::enable_shared_from_this<MapPool> {
 public:
  template <typename T>
  pybind11::array_t<T> take(pybind11::ssize_t height, pybind11::ssize_t width) {
    const std::size_t bytes = static_cast<std::size_t>(height * width) * sizeof(T);
    auto lease = std::make_unique<Lease>();
    lease->pool = shared_from_this();
    lease->memory = find(bytes);
    void* memory = lease->memory.get();
    const pybind11::capsule owner(lease.get(), [](void* pointer) {
      const std::unique_ptr<Lease> done(static_cast<Lease*>(pointer));
      done->pool->give_back(std::move(done->memory));
    });
    lease.release();
    return pybind11::array_t<T>({height, width}, static_cast<T*>(memory), owner);
  }

 private:
  static constexpr std::size_t kMost = 12;  // the maps of two frames

  struct Lease {
    std::shared_ptr<MapPool> pool;
    Buffer<u8> memory;
  };

  Buffer<u8> find(std::size_t bytes) {
    const std::lock_guard<std::mutex> guard(busy_);
    for (auto place = free_.begin(); place != free_.end(); ++place)
      if (place->count() == bytes) {
        Buffer<u8> found = std::move(*place);
        free_.erase(place);
        return found;
      }
    Buffer<u8> fresh;
    fresh.resize(bytes);
    return fresh;
  }

  void give_back(Buffer<u8> memory) {
    const std::lock_guard<std::mutex> guard(busy_);
    if (free_.size() >= kMost) free_.erase(free_.begin());  // the oldest: sizes may have changed
    free_.push_back(std::move(memory));
  }

  std::mutex busy_;
  std::vector<Buffer<u8>> free_;
};

}  // namespace census
