// The Vulkan layer, always under validation: good use is silent, and a wrong use is not.
#include "render/backend.hpp"
#include "vulkan/device.hpp"

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <optional>
#include <random>

#include <gtest/gtest.h>

#include "core/error.hpp"
#include "core/stopwatch.hpp"

#ifdef __SANITIZE_ADDRESS__
/// The layer 1.3.239 drops some memory for every shader that it looks at; drivers and our own code do not.
extern "C" const char* __lsan_default_suppressions() { return "leak:libVkLayer_khronos_validation.so\n"; }
#endif

namespace pellucid::vulkan {
namespace {

constexpr std::uint32_t kDeviceProbe[] = {
#include "shaders/device_probe.comp.inc"
};

/// Push constants of device_probe.comp.glsl.
struct ProbePush {
    std::uint64_t buffer_address;
    std::uint32_t count, factor, addend, places;
};
enum Operation : std::uint32_t { affine, atomic_min };

[[nodiscard]] Kernel probe(const Device& device, Operation operation, std::uint32_t workgroup_size = 64) {
    const std::uint32_t constants[] = {workgroup_size, operation};
    return {device, kDeviceProbe, {.push_bytes = sizeof(ProbePush), .constants = constants}};
}

template <class T>
[[nodiscard]] std::vector<T> downloaded(const Device& device, const Buffer& buffer) {
    std::vector<T> values(buffer.bytes() / sizeof(T));
    download(device, buffer, std::as_writable_bytes(std::span(values)));
    return values;
}

[[nodiscard]] std::vector<std::byte> random_bytes(std::size_t count, unsigned seed) {
    std::mt19937 random(seed);
    std::vector<std::byte> bytes(count);
    std::uint32_t word = 0;
    for (std::size_t i = 0; i < count; ++i) {
        word = i % 4 == 0 ? static_cast<std::uint32_t>(random()) : word >> 8;
        bytes[i] = static_cast<std::byte>(word);
    }
    return bytes;
}

/// The error that `run` ends with.
template <class Run>
[[nodiscard]] std::optional<Error> error_of(Run&& run) {
    try {
        run();
    } catch (const Error& error) {
        return error;
    }
    return std::nullopt;
}

void expect_one_line(const Error& error, Failure kind, const std::string& part) {
    const std::string text = error.what();
    EXPECT_EQ(error.kind(), kind) << text;
    EXPECT_NE(text.find(part), std::string::npos) << text;
    EXPECT_EQ(text.find('\n'), std::string::npos) << text;
}

class VulkanLayer : public testing::Test {
protected:
    void SetUp() override {
        if (!Backend::has_vulkan()) GTEST_SKIP() << "skipped: no Vulkan device";
        device_.emplace(DeviceOptions{.validate = true});
    }
    /// What is left of a device's objects when it goes is a message too.
    void TearDown() override {
        if (!device_) return;
        if (!wrong_use_) {
            EXPECT_EQ(device_->validation_messages(), std::vector<std::string>{});
        }
        testing::internal::CaptureStderr();
        device_.reset();
        EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
    }
    const Device& device() const { return *device_; }

    bool wrong_use_ = false;
    std::optional<Device> device_;
};

// Devices

TEST_F(VulkanLayer, ListsTheDeviceItChooses) {
    const std::vector<DeviceInfo> all = list_devices();
    const auto is_chosen = [&](const DeviceInfo& d) { return d.name == device().info().name; };
    const auto chosen = std::find_if(all.begin(), all.end(), is_chosen);
    ASSERT_NE(chosen, all.end());
    EXPECT_TRUE(chosen->usable);
    EXPECT_EQ(chosen->why_not, "");
    EXPECT_NE(chosen->driver, "");
    EXPECT_GE(chosen->max_workgroup_size, 128U);  // what Vulkan promises
    EXPECT_GE(chosen->shared_bytes, 16384U);
    EXPECT_GE(chosen->subgroup_size, 1U);
    EXPECT_GT(chosen->heap_bytes, 0U);
    EXPECT_LE(chosen->largest_allocation, chosen->heap_bytes);
    const auto is_usable_gpu = [](const DeviceInfo& d) { return d.is_gpu && d.usable; };
    EXPECT_EQ(chosen->is_gpu, std::any_of(all.begin(), all.end(), is_usable_gpu));
}

TEST_F(VulkanLayer, FindsADeviceByAPartOfItsNameInAnyCase) {
    const std::string whole = device().info().name;
    std::string part = whole.substr(0, whole.size() / 2);
    for (char& c : part) {
        const auto letter = static_cast<unsigned char>(c);
        c = static_cast<char>(std::isupper(letter) != 0 ? std::tolower(letter) : std::toupper(letter));
    }
    EXPECT_EQ(Device({.name = part, .validate = true}).info().name, whole);
}

TEST_F(VulkanLayer, AnUnknownNameIsAMissingDeviceThatListsThoseThereAre) {
    const auto error = error_of([] { const Device none({.name = "no such\ndevice"}); });
    ASSERT_TRUE(error);
    expect_one_line(*error, Failure::device, device().info().name);
    expect_one_line(*error, Failure::device, "\"no such device\"");
}

/// A device's failure where these variables point to no file; in another process, because the loader of
/// this one may have read them.
void expect_missing_device(const std::vector<const char*>& variables, const DeviceOptions& options,
                           const char* message) {
    const auto child = [&] {
        for (const char* variable : variables) setenv(variable, "/nonexistent", 1);
        const auto error = error_of([&] { const Device none(options); });
        if (error) std::fprintf(stderr, "%s\n", error->what());
        std::exit(error && (options.validate || list_devices().empty()) ? error->exit_code() : 0);
    };
    testing::FLAGS_gtest_death_test_style = "threadsafe";
    EXPECT_EXIT(child(), testing::ExitedWithCode(3), message);
}

TEST(VulkanWithoutDriver, ListIsEmptyAndADeviceIsMissing) {
    expect_missing_device({"VK_ICD_FILENAMES", "VK_DRIVER_FILES"}, {}, "^no Vulkan device[^\n]*\n$");
}

TEST(VulkanWithoutDriver, AMissingValidationLayerNamesItsPackage) {
    expect_missing_device({"VK_LAYER_PATH"}, {.validate = true},
                          "^no layer [^\n]* vulkan-validationlayers\n$");
}

// Buffers

void expect_round_trips(const Device& device, const std::vector<BufferKind>& kinds,
                        const std::vector<std::size_t>& sizes) {
    for (const BufferKind kind : kinds)
        for (const std::size_t size : sizes) {
            const Buffer buffer(device, size, kind);
            EXPECT_EQ(buffer.bytes(), size);
            EXPECT_NE(buffer.address(), 0U);
            EXPECT_EQ(buffer.address() % 16, 0U);
            if (kind != BufferKind::device) {
                EXPECT_EQ(buffer.mapped().size(), size);
            }
            const std::vector<std::byte> bytes = random_bytes(size, 1);
            upload(device, buffer, bytes);
            EXPECT_EQ(downloaded<std::byte>(device, buffer), bytes);
            // The last third replaced, and read alone.
            const std::size_t offset = size - size / 3;
            const std::vector<std::byte> end = random_bytes(size / 3, 2);
            upload(device, buffer, end, offset);
            std::vector<std::byte> back(end.size());
            download(device, buffer, back, offset);
            EXPECT_EQ(back, end);
            std::vector<std::byte> start(offset);
            download(device, buffer, start);
            EXPECT_TRUE(std::equal(start.begin(), start.end(), bytes.begin()));
        }
}

TEST_F(VulkanLayer, BytesComeBackForEveryKindSizeAndOffset) {
    expect_round_trips(device(), {BufferKind::device, BufferKind::upload, BufferKind::readback},
                       {1, 3, 4097, 1'000'003});
}

TEST_F(VulkanLayer, BytesComeBackThroughStaging) {
    const Device discrete({.validate = true, .stage_all = true});
    EXPECT_TRUE(Buffer(discrete, 16).mapped().empty());
    expect_round_trips(discrete, {BufferKind::device}, {1, 3, 4097, 70'000'001});  // the last in two parts
    EXPECT_EQ(discrete.bytes_held(), 0U);
    EXPECT_EQ(discrete.validation_messages(), std::vector<std::string>{});
}

TEST_F(VulkanLayer, CopiesAndFillsReachTheirBytesOnly) {
    const std::vector<std::byte> bytes = random_bytes(1003, 3);
    const Buffer from(device(), 1003, BufferKind::upload);
    const Buffer to(device(), 1003, BufferKind::readback);
    upload(device(), from, bytes);
    Commands commands(device());
    commands.fill(to, 0, 1000, 0x04030201U);
    commands.barrier();
    commands.copy(from, 7, to, 101, 333);
    commands.submit_and_wait();
    const std::vector<std::byte> back = downloaded<std::byte>(device(), to);
    for (std::size_t i = 0; i < 1000; ++i) {
        const bool copied = i >= 101 && i < 101 + 333;
        ASSERT_EQ(back[i], copied ? bytes[i - 101 + 7] : static_cast<std::byte>(i % 4 + 1)) << i;
    }
}

TEST_F(VulkanLayer, AnEmptyBufferTakesEverythingOfNoLength) {
    const Buffer empty(device(), 0);
    EXPECT_EQ(empty.bytes(), 0U);
    EXPECT_EQ(empty.address(), 0U);
    EXPECT_TRUE(empty.mapped().empty());
    upload(device(), empty, {});
    download(device(), empty, {});
    Commands commands(device());
    commands.fill(empty, 0, 0, 1);
    commands.copy(empty, 0, empty, 0, 0);
    commands.dispatch(probe(device(), affine), ProbePush{}, device().groups_for(0, 64));
    EXPECT_TRUE(commands.submit_and_wait().empty());
    EXPECT_EQ(device().bytes_held(), 0U);
}

TEST_F(VulkanLayer, CountsBytesHeldAndTheirPeak) {
    {
        const Buffer a(device(), 1000);
        Buffer b(device(), 50);
        EXPECT_EQ(device().bytes_held(), 1050U);
        b = Buffer(device(), 20);  // the old one goes after the new one came
        EXPECT_EQ(device().bytes_held(), 1020U);
        EXPECT_EQ(device().peak_bytes(), 1070U);
        const Buffer moved = std::move(b);
        EXPECT_EQ(device().bytes_held(), 1020U);
    }
    EXPECT_EQ(device().bytes_held(), 0U);
    EXPECT_EQ(device().peak_bytes(), 1070U);
}

TEST_F(VulkanLayer, ABufferThatDoesNotFitIsARunErrorWithBytesAskedAndTheHeap) {
    for (const std::uint64_t bytes : {std::uint64_t{1} << 40, std::numeric_limits<std::uint64_t>::max()}) {
        const auto error = error_of([&] { const Buffer huge(device(), bytes); });
        ASSERT_TRUE(error);
        expect_one_line(*error, Failure::run, std::to_string(bytes));
        expect_one_line(*error, Failure::run, std::to_string(device().info().heap_bytes));
    }
    EXPECT_EQ(device().bytes_held(), 0U);
    const Buffer fits(device(), 100);  // the device is as good as before
}

TEST_F(VulkanLayer, TheDeviceMayGoBeforeWhatItMade) {
    testing::internal::CaptureStderr();
    {
        std::optional<Device> first;
        first.emplace(DeviceOptions{.validate = true});
        const Buffer buffer(*first, 16, BufferKind::readback);
        const Kernel kernel = probe(*first, affine);
        Commands commands(*first);
        first.reset();
        commands.fill(buffer, 0, 16, 5);
        commands.barrier();
        commands.dispatch(kernel, ProbePush{buffer.address(), 4, 2, 1, 0}, {});
        commands.submit_and_wait();
        for (const std::size_t i : {0U, 4U, 8U, 12U}) EXPECT_EQ(std::to_integer<int>(buffer.mapped()[i]), 11);
    }
    EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}

// Kernels

TEST_F(VulkanLayer, AddressesReachBeyondTheLargestBinding) {
    constexpr std::uint32_t kCount = 40U << 20;  // 160 MiB; a storage-buffer binding may end at 128
    const Buffer buffer(device(), 4ULL * kCount);
    std::vector<std::uint32_t> values(kCount);
    for (std::uint32_t i = 0; i < kCount; ++i) values[i] = i;
    upload(device(), buffer, std::as_bytes(std::span(values)));
    const Kernel kernel = probe(device(), affine);
    Commands commands(device());
    commands.dispatch(kernel, ProbePush{buffer.address(), kCount, 2, 0, 0}, device().groups_for(kCount, 64));
    commands.submit_and_wait();
    download(device(), buffer, std::as_writable_bytes(std::span(values)));
    int wrong = 0;
    for (std::uint32_t i = 0; i < kCount; ++i) wrong += values[i] != 2 * i ? 1 : 0;
    EXPECT_EQ(wrong, 0);
}

TEST_F(VulkanLayer, GroupsForHasEveryInvocationOnce) {
    // More groups than a row holds on most devices, and an odd count: none is left out or comes twice.
    const std::uint32_t count = 65535U * 8 * 3 + 13;
    const Groups groups = device().groups_for(count, 8);
    EXPECT_GE(std::uint64_t{groups.x} * groups.y * groups.z * 8, count);
    const Buffer buffer(device(), 4ULL * count);
    const Kernel kernel = probe(device(), affine, 8);
    Commands commands(device());
    commands.fill(buffer, 0, buffer.bytes(), 1);
    commands.barrier();
    commands.dispatch(kernel, ProbePush{buffer.address(), count, 3, 4, 0}, groups);
    commands.submit_and_wait();
    const auto values = downloaded<std::uint32_t>(device(), buffer);
    EXPECT_EQ(std::count(values.begin(), values.end(), 7U), count);
}

TEST_F(VulkanLayer, SpecialisationAndPushConstantsReachTheShader) {
    const Buffer buffer(device(), 400);
    Commands commands(device());
    commands.fill(buffer, 0, 400, 1);
    // Workgroups of several sizes (constant 0); the push constants of each dispatch are its own.
    const std::uint32_t sizes[] = {1, 7, 64};
    std::vector<Kernel> kernels;
    for (const std::uint32_t size : sizes) kernels.push_back(probe(device(), affine, size));
    std::uint32_t expected = 1;
    for (std::uint32_t k = 0; k < 3; ++k) {
        commands.barrier();
        commands.dispatch(kernels[k], ProbePush{buffer.address(), 100, k + 2, 10 * k, 0},
                          device().groups_for(100, sizes[k]));
        expected = expected * (k + 2) + 10 * k;
    }
    commands.submit_and_wait();
    EXPECT_EQ(downloaded<std::uint32_t>(device(), buffer), std::vector<std::uint32_t>(100, expected));
}

TEST_F(VulkanLayer, SixtyFourBitAtomicMinimumIsThatOfTheHost) {
    constexpr std::uint32_t kCount = 1U << 20;
    for (const std::uint32_t places : {1U, 37U, 1U << 16}) {
        const Buffer buffer(device(), 8ULL * places);
        const Kernel kernel = probe(device(), atomic_min);
        Commands commands(device());
        commands.fill(buffer, 0, buffer.bytes(), 0xffffffffU);
        commands.barrier();
        commands.dispatch(kernel, ProbePush{buffer.address(), kCount, 0, 0, places},
                          device().groups_for(kCount, 64));
        commands.submit_and_wait();
        std::vector<std::uint64_t> minima(places, ~std::uint64_t{0});
        for (std::uint32_t i = 0; i < kCount; ++i)
            minima[i % places] = std::min(minima[i % places], std::uint64_t{i * 0x9e3779b1U} << 32 | i);
        EXPECT_EQ(downloaded<std::uint64_t>(device(), buffer), minima) << places;
    }
}

// Times

TEST_F(VulkanLayer, StageTimesAreSummedByNameAndWithinTheWallClock) {
    const Buffer buffer(device(), 4U << 20);
    const Kernel kernel = probe(device(), affine);
    Commands commands(device());
    for (int submission = 0; submission < 2; ++submission) {
        for (int i = 0; i < 700; ++i) {  // 1400 marks
            commands.begin_stage(i % 2 == 0 ? "even" : "odd");
            commands.dispatch(kernel, ProbePush{buffer.address(), 1000, 1, 1, 0},
                              device().groups_for(1000, 64));
            commands.barrier();
            commands.end_stage();
        }
        commands.begin_stage("fill");
        commands.fill(buffer, 0, buffer.bytes(), 0);
        commands.end_stage();
        Stopwatch clock;
        const std::vector<StageTime> times = commands.submit_and_wait();
        const double wall_s = clock.lap();
        ASSERT_EQ(times.size(), 3U);
        EXPECT_EQ(times[0].name, "even");
        EXPECT_EQ(times[1].name, "odd");
        EXPECT_EQ(times[2].name, "fill");
        double sum = 0;
        for (const StageTime& t : times) {
            EXPECT_GT(t.seconds, 0) << t.name;
            sum += t.seconds;
        }
        EXPECT_LE(sum, wall_s);  // a wrong period, or an end before its begin, would not fit
    }
    commands.fill(buffer, 0, 4, 0);
    EXPECT_TRUE(commands.submit_and_wait().empty());  // no marks left from before
}

// Validation

TEST_F(VulkanLayer, ValidationSpeaksUpWhereAShaderReadsPushConstantsItsKernelLacks) {
    wrong_use_ = true;
    const std::uint32_t constants[] = {64, affine};
    const Kernel wrong(device(), kDeviceProbe, {.push_bytes = 8, .constants = constants});
    const std::vector<std::string> messages = device().validation_messages();
    ASSERT_FALSE(messages.empty());
    EXPECT_NE(messages[0].find("Push constant"), std::string::npos) << messages[0];
}

}  // namespace
}  // namespace pellucid::vulkan
