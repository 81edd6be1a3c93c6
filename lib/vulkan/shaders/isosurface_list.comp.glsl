// An isosurface with all virtual slabs kept (slab_list.glsl): tests.
#version 460
#include "cast_plain.glsl"
#include "slab_list.glsl"
#include "isosurface_slabs.glsl"
