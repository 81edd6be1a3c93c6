// A user's program: headers found, library linked, threads running.
#include <atomic>
#include <cstddef>
#include <cstdio>

#include <core/image.hpp>
#include <core/parallel.hpp>

int main() {
    pellucid::Image image(8, 4);
    image.add("A", 0.5F);
    std::atomic<std::size_t> pixels = 0;
    pellucid::parallel_for(image.pixel_count(), 1,
                           [&](std::size_t begin, std::size_t end) { pixels += end - begin; });
    std::printf("%zu pixels\n", pixels.load());
    return pixels == 32 ? 0 : 1;
}
