"""Every proven candidate of a small world, worked out from the raw JSON by brute force.

Plain Python over the facts of `oracle_facts.Oracle`; nothing of the engine is used. `proven(root, sequence)` returns
{(template, target track, canonical plan, answer)}.
"""

from __future__ import annotations

from oracle_alone import Alone
from oracle_chains import Chains
from oracle_gaps import Gaps


class World(Alone, Chains, Gaps):
    def of(self, track, t0):
        """Every proven candidate that begins with this person described at this keyframe."""
        templates = (
            self.start_and_span,
            self.change,
            self.presence,
            self.distance,
            self.consequence,
            self.poses_of_chains,
            self.later_pose,
            self.action_search,
            self.fork_join,
            self.gap_starts,
            self.gap_absence,
            self.gap_count,
        )
        return set().union(*(template(track, t0) for template in templates))


def proven(root, sequence):
    world = World(root, sequence)
    return {found for t0 in world.keyframes for track in world.in_frame(t0) for found in world.of(track, t0)}
