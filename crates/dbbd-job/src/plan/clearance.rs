//! The distance of bar, tool and arm from obstacles.
//!
//! Each moving part is a capsule: a segment with a radius. The distance of a point from a convex body is a convex function of
//! the point, so that along a segment it has one minimum, which a golden-section search finds.

use nalgebra::Vector3;

use super::job::ObstacleTable;

/// Length of the bar from its ball that is not checked, mm: there it is in the cup, whose limit guards it.
pub(crate) const IN_CUP_MM: f64 = 50.0;

/// A segment from one point to another, mm.
pub type LineSegment = [Vector3<f64>; 2];

/// Golden-section steps: a segment of 2 m is known to 1e-4 mm.
const GOLDEN_SECTION_STEPS: u32 = 36;

impl ObstacleTable {
    /// Distance of a point from the obstacle, mm; 0 inside.
    pub fn from_point(&self, point: &Vector3<f64>) -> f64 {
        match *self {
            Self::Box { low_mm, high_mm } => {
                let outside = |i: usize| (low_mm[i] - point[i]).max(point[i] - high_mm[i]).max(0.0);
                Vector3::new(outside(0), outside(1), outside(2)).norm()
            }
            Self::Cylinder { from_mm, to_mm, radius_mm } => {
                let (from, to) = (Vector3::from(from_mm), Vector3::from(to_mm));
                let length = (to - from).norm();
                let along = (to - from) / length;
                let height = along.dot(&(point - from));
                let beside = (point - from - along * height).norm() - radius_mm;
                (height - length).max(-height).max(0.0).hypot(beside.max(0.0))
            }
            Self::Floor { z_mm } => (point.z - z_mm).max(0.0),
        }
    }

    /// Distance of a segment from the obstacle, mm; 0 where they meet.
    pub fn from_segment(&self, [from, to]: &LineSegment) -> f64 {
        const GOLDEN: f64 = 0.618_033_988_749_895;
        let at = |share: f64| self.from_point(&from.lerp(to, share));
        let (mut low, mut high) = (0.0, 1.0);
        let (mut left, mut right) = (1.0 - GOLDEN, GOLDEN);
        let (mut left_value, mut right_value) = (at(left), at(right));
        let mut least = at(0.0).min(at(1.0));
        for _ in 0..GOLDEN_SECTION_STEPS {
            least = least.min(left_value).min(right_value);
            if left_value <= right_value {
                (high, right, right_value) = (right, left, left_value);
                left = high - GOLDEN * (high - low);
                left_value = at(left);
            } else {
                (low, left, left_value) = (left, right, right_value);
                right = low + GOLDEN * (high - low);
                right_value = at(right);
            }
        }
        least
    }
}
