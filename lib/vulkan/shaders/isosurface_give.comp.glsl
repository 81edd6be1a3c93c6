// An isosurface as virtual slabs that meet the pixel's array (slab_given_sink.glsl).
#version 460
#include "cast_plain.glsl"
#include "slab_given_sink.glsl"
#include "isosurface_slabs.glsl"
