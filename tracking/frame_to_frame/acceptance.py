"""When a pose is accepted: the thresholds that tracking from frame to frame and the refinement along flights share.

A cost is that of `tracking.picture.pose_costs`, measured from the usual one of the clip. Distances are in units of the die's
reach, that of its farthest point from its centre.
"""

from __future__ import annotations

from math import radians

MIN_SUPPORT = 0.45
"""Least support (`Pose.support`) of a die wholly in view. On edges random poses have 0.1 to 0.3, and an edge before a table of
the same grey has none; on whole surfaces poses beside the die had up to 0.49 in twelve random clips, true ones 0.46 or more."""
ON_PATH_SUPPORT = 0.3
"""The same of a pose that lies where its flight puts it: more than random poses have."""
MIN_SUPPORT_CUT = 0.6
"""The same of a die that is cut by the border: a shorter contour is supported by chance more often."""
KNOWN_RAD = radians(6.0)
"""Largest standard error [rad] of the orientation of an accepted pose."""

ACCEPTED_EXCESS_COST = 0.35
"""Cost above the usual up to which the motion explains the picture. More rejects true poses in changing light less often; less
finds bounces sooner."""
MAX_EXCESS_COST = 2.5
"""The same of a badly seen pose that something else supports: it lies on the predicted path, or no other explains the picture
better."""
USUAL_COST_FRAMES = 8.0
"""Frames that the usual cost is a running mean of. Fewer follow a change of light sooner; more scatter less."""

MIN_POSES_OF_FLIGHT = 3
"""Poses of a flight from which on its velocities are known: two determine them, and the third confirms them."""
NEW_FLIGHT_REACH = 0.14
"""Distance between the prediction of a known flight and a pose beyond which the pose belongs to a new flight. Less takes errors
of badly seen poses for bounces; more attributes weak bounces to the flight before, until the throw is measured."""
NEW_FLIGHT_RAD = radians(2.0)
"""Angle [rad] between them beyond which it does, for the same reason."""
ON_PATH_CHI2 = 30.0
"""Normalised innovation squared (six numbers) up to which a pose lies on the predicted path: one in 25 000 of honest poses lies
farther off."""
SAME_FLIGHT_CHI2 = 16.0
"""The same up to which a pose belongs to its flight although turned by more than `NEW_FLIGHT_RAD`: a face seen alone tells
its tilt to some degrees only. One in 70 of honest poses lies farther off; the weakest impact of four clips had 19."""
YOUNG_FLIGHT_CHI2 = 5.35
"""The same of a flight whose spin is known so badly that impacts would pass: half of honest poses lie nearer."""
YOUNG_FLIGHT_POSES = 6.0
"""Poses below which a flight is one of these."""
BOUNCE_REACH = 0.35
"""Height of the lowest corner, in circumradii, below which an impact may have occurred between two frames."""
HEIGHT_SIGMAS = 3.0
"""Standard errors of the prediction by which it must be higher."""
PRIOR_SIGMAS = 4.0
"""Width of the prior of a refinement, in standard errors of the prediction: wide enough not to hold a bounce back."""

PREDICTED_SIGMAS = 3.0
"""Standard errors of the prediction up to which a pose belongs to its flight; the larger bound of this and `NEW_FLIGHT_REACH`
counts."""
SMALL_EXCESS_COST = 0.05
"""Cost above the usual up to which a hypothesis ends the search for a better one."""
SURFACE_EXCESS_SHARE = 0.25
"""Cost above the usual, as a share of it, up to which a pose after an impact is accepted if the whole surface is compared: it
varies with the faces in view. Right poses on two clips, one of them in H.264, came to a seventh."""
CLEAR_SUPPORT = 0.8
"""Share of the contour with a clear step that shows a die beyond doubt: a rod in front of it takes away more."""
FASTEST_FACTOR = 1.5
"""Speed of the die's points after an impact over that before, at the most: no impact gives energy."""
FASTEST_CENTRE_FACTOR = 1.1
"""The same of its centre over the speed at which it would fly with all its energy."""
FASTEST_M_S = 5.0
"""Speed of a die of which nothing is known: a fall from more than a metre."""
SEEN_REACH = 0.07
"""Error of the place of single poses, as the camera sees it, in units of the die's reach."""
FASTEST_FACTOR_BACKWARDS = 4.0
"""Speed before an impact over that after, at the most. A corner alone may lose more: a restitution of 0.15 leaves a seventh."""
AMBIGUOUS_COST = 0.5
"""Cost above the least up to which other poses of a picture leave open which is right. Of a tetrahedron that turns one face to
the camera wrong poses cost 0.4 less than the right one."""
