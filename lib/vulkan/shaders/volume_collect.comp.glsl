// Volume stage: the array of each ray is compressed as it comes (slab_collect.glsl).
#version 460
#include "cast_volume.glsl"
#include "slab_collect.glsl"
#include "volume_cast.glsl"
