// Floats that begin on a cache line: vectors of 64 bytes that cross from one to the next take twice the time.
#pragma once
#include <cstddef>
#include <new>
#include <vector>

namespace ggvs {

template <class T>
struct CacheLineAllocator {
    using value_type = T;
    static constexpr std::align_val_t kCacheLine{64};

    CacheLineAllocator() = default;
    template <class U>
    CacheLineAllocator(const CacheLineAllocator<U>&) {}

    T* allocate(size_t count) { return static_cast<T*>(::operator new(count * sizeof(T), kCacheLine)); }
    void deallocate(T* p, size_t) { ::operator delete(p, kCacheLine); }

    template <class U>
    bool operator==(const CacheLineAllocator<U>&) const {
        return true;
    }
    template <class U>
    bool operator!=(const CacheLineAllocator<U>&) const {
        return false;
    }
};

using AlignedFloats = std::vector<float, CacheLineAllocator<float>>;

}  // namespace ggvs
