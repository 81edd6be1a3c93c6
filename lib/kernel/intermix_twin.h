// The intermixing kernel of two zSlabs (zSlab dissertation, section 5.3 and figure 4.2), and one step of the scan
// that merges two sorted arrays (section 4.2). No memory is touched here: cursors are the caller's.
#ifndef PELLUCID_KERNEL_INTERMIX_TWIN_H
#define PELLUCID_KERNEL_INTERMIX_TWIN_H
#include "kernel/slab_twin.h"
TWIN_BEGIN

struct Intermixed {
    Slab integrated;  // ends where prior ends
    Slab remaining;   // ends where posterior ends
    uint remains;     // 0: nothing remains
};

// Prior is the slab whose back is nearer. What is in front of the shared interval is composited with the mixture in
// it; what of posterior lies behind remains.
//   no overlap              prior, posterior
//   partial overlap         front of prior over mixture, rest of posterior
//   prior inside posterior  front of posterior over mixture, rest of posterior
//   equal backs             both end, nothing remains; the same bits for either order
// A slab without thickness is a surface: inside of a slab it divides it; at its front it lies before it, at its back
// behind it; two at one depth mix as slabs of one interval do. Precondition: prior.z <= posterior.z.
TWIN_FN Intermixed intermix(Slab prior, Slab posterior, uint interpolation, uint mixing) {
    float prior_front = slab_front(prior);
    float posterior_front = slab_front(posterior);
    bool both_end = !(prior.z < posterior.z);
    bool apart = posterior_front >= prior.z && !both_end;

    // The one that begins first is cut where the other begins.
    bool prior_leads = prior_front < posterior_front;
    float begin = min(max(prior_front, posterior_front), prior.z);
    Slab leader = pick_slab(prior_leads, prior, posterior);
    SlabParts led = split_slab(leader, min(prior_front, posterior_front), begin, interpolation);
    Slab prior_rest = pick_slab(prior_leads, led.back, prior);
    Slab posterior_rest = pick_slab(prior_leads, posterior, led.back);

    // Posterior is cut where prior ends.
    SlabParts cut = split_slab(posterior_rest, begin, prior.z, interpolation);
    Slab mixture = mix_slabs(prior_rest, pick_slab(both_end, posterior_rest, cut.front), mixing);
    float posterior_d = pick(both_end, posterior.d, thickness_between(min(posterior_front, begin), prior.z));

    Intermixed r;
    r.integrated = slab_over(led.front, mixture);
    r.integrated.z = prior.z;
    r.integrated.d = pick(posterior_front < prior_front, posterior_d, prior.d);
    r.integrated = pick_slab(apart, prior, r.integrated);
    r.remaining = pick_slab(apart, posterior, cut.back);
    r.remains = uint(!both_end);
    return r;
}

// One step of merging arrays A and B, whose next slabs are a and b: one slab goes out, and of each array the caller
// takes the next slab where it is used up, else goes on with what is given here. Every step uses up one at least.
struct MergeStep {
    Slab out_slab;
    Slab a;
    Slab b;
    uint a_used;
    uint b_used;
};
TWIN_FN MergeStep merge_step(Slab a, Slab b, uint interpolation, uint mixing) {
    bool a_first = a.z <= b.z;
    Intermixed r = intermix(pick_slab(a_first, a, b), pick_slab(a_first, b, a), interpolation, mixing);
    bool none = r.remains == 0u;
    MergeStep s;
    s.out_slab = r.integrated;
    s.a = r.remaining;
    s.b = r.remaining;
    s.a_used = uint(a_first || none);
    s.b_used = uint(!a_first || none);
    return s;
}

TWIN_END
#endif
