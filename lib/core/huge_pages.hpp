// Large arrays on large pages: an image of sums is 60 MB, and touching it page by page for the first time
// takes longer than drawing a few million particles.
#pragma once

#include <cstddef>
#include <cstdlib>
#include <new>

#include <sys/mman.h>

namespace pellucid {

/// As std::allocator; arrays of 4 MB and more ask the system for pages of 2 MB, which it may refuse.
template <class T>
struct HugePageAllocator {
    using value_type = T;
    HugePageAllocator() = default;
    template <class U>
    HugePageAllocator(const HugePageAllocator<U>&) noexcept {}

    [[nodiscard]] T* allocate(std::size_t count) {
        constexpr std::size_t kPage = std::size_t{2} << 20U;
        if (count > static_cast<std::size_t>(-1) / (2 * sizeof(T))) throw std::bad_alloc();
        const std::size_t bytes = count * sizeof(T);
        const std::size_t alignment = bytes >= 2 * kPage ? kPage : 64;
        void* memory = std::aligned_alloc(alignment, (bytes + alignment - 1) / alignment * alignment);
        if (memory == nullptr) throw std::bad_alloc();
        if (alignment == kPage) (void)madvise(memory, bytes, MADV_HUGEPAGE);  // a wish
        return static_cast<T*>(memory);
    }
    void deallocate(T* memory, std::size_t) noexcept { std::free(memory); }
    friend bool operator==(const HugePageAllocator&, const HugePageAllocator&) { return true; }
};

}  // namespace pellucid
