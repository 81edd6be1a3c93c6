// Volume stage: the array of each ray is compressed as it comes (slab_collect.glsl).
#version 460
#include "cast_plain.glsl"
#include "plain_volume.glsl"
#include "slab_collect.glsl"
#include "plain_volume_cast.glsl"
