//! The place of each row on its circle.

use super::circle::Circle;
use super::{Kind, Plan};

/// A dwell's place on its circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CirclePlace {
    /// Angle of its pose as rounded for the program, degrees from the plane's first axis, 0..360.
    pub angle_deg: f64,
    /// Whether the pass goes against growing angles.
    pub clockwise: bool,
    /// Nominal radius of the circle, mm.
    pub radius_mm: f64,
}

impl Plan {
    /// For each row its place on its circle; `None` for transit rows and rows of no circle.
    pub fn circle_places(&self) -> Vec<Option<CirclePlace>> {
        let job = &self.header.job;
        let mut measured = vec![0_u32; job.circles.len()];
        self.rows
            .iter()
            .map(|row| {
                let table = job.circle(row.circle).filter(|_| row.kind != Kind::Transit)?;
                let circle = Circle::new(job, table, row.circle).ok()?;
                let visited = measured.get_mut(row.circle as usize - 1)?;
                let clockwise = table.is_clockwise(*visited >= table.points);
                *visited += u32::from(row.kind == Kind::Measure);
                let angle_deg = circle.angle_deg(row.xyz_mm.into());
                Some(CirclePlace { angle_deg, clockwise, radius_mm: circle.radius })
            })
            .collect()
    }
}
