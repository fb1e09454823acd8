"""Reads a recorded cycle as numpy arrays. Usage: python read_cycle.py RECORDING.mcap"""

import sys

from vlad_cell import read_cycle

cycle = read_cycle(sys.argv[1])
print(f"{cycle.result} {cycle.code or ''}: {cycle.reason}")
print("stages [s]:", {name: round(took_s, 2) for name, took_s in cycle.took_s.items()})
print(f"{len(cycle.looks)} looks; color {cycle.color.shape}, depth_m {cycle.depth_m.shape}")
print("fx, fy [px]:", cycle.K[0, 0], cycle.K[1, 1], "camera at [m]:", cycle.base_from_camera[:3, 3].round(3).tolist())
for number, grasp in enumerate(cycle.grasps):
    print("->" if number == cycle.chosen else "  ", f"score {grasp.score:.2f}, {grasp.width_m * 1e3:.0f} mm wide")
joints, hand = cycle.joints, cycle.hand
print(f"joints {joints.q_rad.shape} in {joints.time_s[-1]:.1f} s, at most {abs(joints.dq_rad_s).max():.2f} rad/s")
print(f"the fingers were {hand.width_m.min() * 1e3:.0f} to {hand.width_m.max() * 1e3:.0f} mm apart")
