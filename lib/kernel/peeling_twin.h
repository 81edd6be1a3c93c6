// What the polygon stage on Vulkan reads and writes (vulkan/peeling.hpp): one layout for C++ and for shaders (scalar).
// Geometry is in double, as on the CPU: the depth of a fragment has the CPU's bits.
#ifndef PELLUCID_KERNEL_PEELING_TWIN_H
#define PELLUCID_KERNEL_PEELING_TWIN_H
#include "kernel/shading_twin.h"
#include "kernel/slab_twin.h"
#include "kernel/vec3d_twin.h"
TWIN_BEGIN

// A triangle, or what clipping left of it, on the grid of 1/256 pixel (cpu/rasterizer.hpp: RasterTriangle). Parts ascend
// with the numbers of their triangles.
struct PeelPart {
    int x0;
    int x1;
    int x2;
    int y0;
    int y1;
    int y2;
    uint triangle;  // its number in SceneMeshes
    uint object;    // in PeelSetup::objects, and kPeelJudged
};
// In PeelPart::object: the device's rasteriser would not cover what the CPU's does.
const uint kPeelJudged = 0x80000000u;

// DepthPlane of cpu/rasterizer.hpp, one a part.
struct PeelPlane {
    double base;
    double c0;
    double cu;
    double cv;
    double d0;
    double du;
    double dv;
    double lo;
    double hi;
};

const uint kPeelOblique = 1u;   // opacity depends on the angle
const uint kPeelFlat = 2u;      // unlit
const uint kPeelSmooth = 4u;    // has normals at vertices ...
const uint kPeelOfField = 8u;   // ... which are the geometric normal, too
const uint kPeelPainted = 16u;  // its fragments were shaded beforehand
const uint kPeelBounds = 32u;   // is cut by bounds in its own space

struct PeelObject {
    uint64_t positions;  // Vec3d, world
    uint64_t normals;    // Vec3d, world
    uint64_t triangles;  // 3 uint each
    uint64_t clip;       // 4 double each: keeps n·x <= offset
    uint64_t painted;    // PaintedFragment, by rows of its rectangle
    Vec3d color;
    double opacity;        // straight on
    double optical_depth;  // -ln(1 - opacity)
    double thickness;      // < 0: by pixel
    Vec3d to_object_x;     // columns, then the offset
    Vec3d to_object_y;
    Vec3d to_object_z;
    Vec3d to_object_offset;
    Vec3d lo;  // bounds
    Vec3d hi;
    float ambient;
    float diffuse;
    float specular;
    float shininess;
    uint first_triangle;  // number
    uint flags;
    uint clip_count;
    int painted_x;  // of the rectangle of pixels
    int painted_y;
    int painted_width;
};

// SurfaceFragment of cpu/depth_peeling.hpp.
struct PaintedFragment {
    Slab slab;
    uint object;
    uint triangle;
};

struct PeelLight {
    Vec3f direction;  // to the light, world
    float intensity;
    uint headlight;
};

// Where a pixel stands between two passes. All bits 0: nothing was drawn yet.
struct PeelPixel {
    uint64_t from;  // least place in the order that is still wanted
    double clear;   // what shines through, product of 1 - opacity; 1 where count is 0
    uint most;      // largest depth (or rank) that is still wanted; any where count is 0
    uint count;     // fragments so far
};

// Colour of a pixel while fragments are added from front to back. All bits 0: nothing was drawn yet.
struct PeelColor {
    double r;
    double g;
    double b;
    double clear;  // what shines through the groups that were added; 1 where count is 0
    float z;       // nearest; +infinity where count is 0
    uint count;    // fragments
};

struct PeelSetup {
    uint64_t parts;
    uint64_t planes;
    uint64_t objects;
    uint64_t lights;
    uint64_t slots;    // places in the order, slot after slot
    uint64_t pixels;   // PeelPixel
    uint64_t slabs;    // Slab, target after target
    uint64_t numbers;  // of their triangles
    uint64_t counts;   // of slabs of a pixel in the targets
    uint64_t colors;   // PeelColor
    uint64_t flags;    // PeelFlags
    double most_clear;  // a pixel is finished at so little
    int width;
    int first_row;  // of the image that the buffers have
    int rows;
    uint light_count;
    uint most_layers;  // of a pixel
    uint slot_count;
};

// Rays of pixels' centres, as Camera::ray has them.
struct PeelRays {
    Vec3d eye;
    Vec3d axis_x;
    Vec3d axis_y;
    Vec3d axis_z;
    double center_x;
    double center_y;
    double pixel_size;
};

// What comes as push constants, the same for all invocations: software is slow to read what lies behind an address.
struct PeelDrawPush {
    uint64_t rays;  // PeelRays
    uint64_t parts;
    uint64_t planes;
    uint64_t objects;
    uint64_t order;  // rank of a triangle by its number; 0: by depth
    uint64_t slots;
    uint64_t pixels;
    uint64_t judged;  // numbers of parts
    double center_x;
    double center_y;
    double near_depth;
    double far_depth;
    int width;
    int first_row;
    int rows;
    int viewport_x;  // place of the viewport's corner in the image, pixels
    int viewport_y;
    int viewport_side;  // a power of two
    float shift;     // of the corners, in 1/256 pixel: 0; else the wrong twin of the tests
};
struct PeelShadePush {
    uint64_t setup;
    PeelRays rays;
};

struct PeelFlags {
    uint more;   // some pixel may have fragments that did not fit
    uint stuck;  // some pixel has more at one depth than there are slots
    uint found;  // fragments that this pass brought into targets
    uint pixels;  // that had none before
    uint layers;  // most of a pixel so far
};

TWIN_END
#endif
