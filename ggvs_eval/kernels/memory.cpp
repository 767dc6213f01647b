// What is kept is bounded twice: by its size, and by how many other arrays were made since it was last in use.
#include "memory.hpp"

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <deque>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace ggvs {
namespace {

namespace py = pybind11;

constexpr size_t kLeast = size_t(1) << 18;     // bytes: below, the allocator does as well
constexpr size_t kMostIdle = size_t(1) << 29;  // bytes; more where more was in use: a large step wants all of it again
constexpr uint64_t kMostTurns = 256;
constexpr size_t kAlignment = 64, kHugePage = size_t(1) << 21;

struct Block {
    void* data;
    size_t bytes;
    uint64_t turn;  // when it was given back
};

// Blocks of given-up arrays, the longest idle first. The GIL guards it.
class Idle {
public:
    Block take(size_t bytes) {
        if (++turn_ % kMostTurns == 0) used_before_ = most_used_, most_used_ = used_;
        used_ += bytes;
        most_used_ = std::max(most_used_, used_);
        for (auto block = blocks_.rbegin(); block != blocks_.rend(); ++block) {  // the last in use is the likeliest in the cache
            if (block->bytes != bytes) continue;
            const Block found = *block;
            blocks_.erase(std::next(block).base());
            bytes_ -= bytes;
            return found;
        }
        drop([this](const Block& oldest) { return oldest.turn + kMostTurns < turn_; });
        return allocated(bytes);
    }

    void give_back(Block block) {
        block.turn = turn_;
        blocks_.push_back(block);
        bytes_ += block.bytes;
        used_ -= block.bytes;
        const size_t wanted = std::max(most_used_, used_before_) / 4 * 5;  // blocks of all sizes are more than were in use at once
        drop([this, wanted](const Block&) { return bytes_ > std::max(kMostIdle, wanted); });
    }

    void forget() {
        drop([](const Block&) { return true; });
    }

    size_t bytes() const { return bytes_; }

private:
    static Block allocated(size_t bytes) {
        const size_t alignment = bytes < kHugePage ? kAlignment : kHugePage;
        void* data = ::operator new(bytes, std::align_val_t(alignment));
#if defined(__linux__)
        if (bytes >= kHugePage) madvise(data, bytes, MADV_HUGEPAGE);  // as numpy does; a refusal does no harm
#endif
        return {data, bytes, 0};
    }

    template <class Condition>
    void drop(const Condition& wanted) {
        while (!blocks_.empty() && wanted(blocks_.front())) {
            const Block& oldest = blocks_.front();
            bytes_ -= oldest.bytes;
            ::operator delete(oldest.data, std::align_val_t(oldest.bytes < kHugePage ? kAlignment : kHugePage));
            blocks_.pop_front();
        }
    }

    std::deque<Block> blocks_;
    // Kept; given out, now, at most in the present kMostTurns, which may have just begun, and in those before.
    size_t bytes_ = 0, used_ = 0, most_used_ = 0, used_before_ = 0;
    uint64_t turn_ = 0;
};

// Never destroyed: arrays may outlive whatever a program destroys at its end.
Idle& idle() {
    static Idle* kept = new Idle;
    return *kept;
}

}  // namespace

py::array_t<float> empty(std::vector<py::ssize_t> shape) {
    size_t bytes = sizeof(float);
    for (const py::ssize_t size : shape) {
        if (size < 0) throw py::value_error("empty: sizes must not be negative");
        bytes *= size_t(size);
    }
    if (bytes < kLeast) return py::array_t<float>(std::move(shape));
    auto* block = new Block(idle().take(bytes));
    const py::capsule owner(block, [](void* pointer) {
        auto* given = static_cast<Block*>(pointer);
        idle().give_back(*given);
        delete given;
    });
    return py::array_t<float>(std::move(shape), static_cast<const float*>(block->data), owner);
}

size_t idle_bytes() { return idle().bytes(); }

void forget_idle() { idle().forget(); }

}  // namespace ggvs
