//! Where the axes may be: limits of the axes, and of joints that turn with two of them.

use super::{AXES, Joint, Robot};

impl Robot {
    /// The limits of each axis at axis angles, all in degrees: of a coupled joint's axis what the limits of the joint leave
    /// where the other axis is.
    pub fn limits_at_deg(&self, axes_deg: &[f64; AXES]) -> [[f64; 2]; AXES] {
        std::array::from_fn(|place| {
            let [low, high] = self.limits_deg[place];
            let Some([least, most]) = self.coupled_limits_deg[place] else { return [low, high] };
            let added = self.geometry.coupling.added(place, axes_deg);
            [low.max(least - added), high.min(most - added)]
        })
    }

    /// Least distance of an axis (rad) from its limits, degrees; negative outside.
    pub fn limit_margin_deg(&self, axes: &[f64; AXES]) -> f64 {
        let axes_deg = axes.map(f64::to_degrees);
        let limits = self.limits_at_deg(&axes_deg).into_iter().zip(axes_deg);
        limits.map(|([low, high], deg)| (deg - low).min(high - deg)).fold(f64::INFINITY, f64::min)
    }

    /// Whether all axes (rad) are within their limits.
    pub fn is_within_limits(&self, axes: &[f64; AXES]) -> bool {
        self.limit_margin_deg(axes) >= 0.0
    }

    /// The range of a joint's own angle, degrees.
    pub fn joint_range_deg(&self, joint: Joint) -> [f64; 2] {
        let place = joint.index();
        let [low, high] = self.limits_deg[place];
        let Some(by) = self.geometry.coupling.of(joint) else { return [low, high] };
        let added = self.limits_deg[by.axis.index()].map(|deg| by.factor * deg);
        let [least, most] = [added[0].min(added[1]), added[0].max(added[1])];
        self.coupled_limits_deg[place].unwrap_or([low + least, high + most])
    }
}
