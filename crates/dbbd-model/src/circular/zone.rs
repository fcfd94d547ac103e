//! The minimum zone: the two concentric circles of least radial distance between which all points lie.
//!
//! Linearised about a centre, the problem is a linear programme in centre, offset and half width. Its dual is solved by
//! the simplex method: in a basis of four points, one is exchanged in each step for the point farthest outside the
//! zone. The linearisation is repeated until the centre does not move.

use nalgebra::{Matrix4, Vector4};

use super::fit::RadialMeasurement;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MinimumZone {
    /// The base ball relative to the programmed centre, mm.
    pub centre: [f64; 2],
    pub width_mm: f64,
}

/// Angular sectors whose outermost points are the first candidates.
const SECTORS: usize = 360;
/// With more points the sectors save time.
const MANY: usize = 2 * SECTORS;
/// Convergence limit of centre and zone, mm: a few rounding errors of a length.
const CONVERGED_MM: f64 = 1e-11;

/// The minimum zone, starting at the centre of the least-squares circle. `None` if the points have fewer than three
/// directions.
pub fn minimum_zone(rays: &[RadialMeasurement], centre: [f64; 2]) -> Option<MinimumZone> {
    if rays.len() <= MANY {
        return converge(rays, centre);
    }
    let mut zone = MinimumZone { centre, width_mm: 0.0 };
    let mut chosen: Vec<usize> = Vec::new();
    loop {
        let before = chosen.len();
        chosen.extend(outermost(rays, zone.centre));
        chosen.sort_unstable();
        chosen.dedup();
        if chosen.len() == before {
            return Some(zone);
        }
        let few: Vec<RadialMeasurement> = chosen.iter().map(|&at| rays[at]).collect();
        zone = converge(&few, zone.centre)?;
        if width(rays, zone.centre) - zone.width_mm < CONVERGED_MM {
            return Some(zone);
        }
    }
}

/// Repeats the linear programme until the centre does not move.
fn converge(rays: &[RadialMeasurement], mut centre: [f64; 2]) -> Option<MinimumZone> {
    for _ in 0..20 {
        let [x, y] = shift(rays, centre)?;
        centre = [centre[0] + x, centre[1] + y];
        if x.hypot(y) < CONVERGED_MM {
            break;
        }
    }
    Some(MinimumZone { centre, width_mm: width(rays, centre) })
}

/// Width of the zone of all points about `centre`, mm.
pub(super) fn width(rays: &[RadialMeasurement], centre: [f64; 2]) -> f64 {
    let [low, high] = extremes(rays, centre);
    high - low
}

/// Least and greatest deviation about `centre`, mm.
pub(super) fn extremes(rays: &[RadialMeasurement], centre: [f64; 2]) -> [f64; 2] {
    rays.iter()
        .map(|ray| ray.deviation(centre))
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], d| [low.min(d), high.max(d)])
}

/// The points with the least and the greatest deviation of each sector.
pub(super) fn outermost(rays: &[RadialMeasurement], centre: [f64; 2]) -> Vec<usize> {
    let mut sectors = [None::<[(usize, f64); 2]>; SECTORS];
    for (at, ray) in rays.iter().enumerate() {
        let (reach, [x, y]) = ray.reach(centre);
        let here = (at, ray.length_mm - reach);
        if let Some(sector) = sectors.get_mut(sector(x, y)) {
            let [low, high] = sector.get_or_insert([here; 2]);
            if here.1 < low.1 {
                *low = here;
            }
            if here.1 > high.1 {
                *high = here;
            }
        }
    }
    sectors.into_iter().flatten().flatten().map(|(at, _)| at).collect()
}

/// The sector of a direction. The numbering only has to increase with the angle, so no arctangent is needed.
fn sector(x: f64, y: f64) -> usize {
    let along = y.abs() / (x.abs() + y.abs());
    let turn = match (x >= 0.0, y >= 0.0) {
        (true, true) => along,
        (false, true) => 2.0 - along,
        (false, false) => 2.0 + along,
        (true, false) => 4.0 - along,
    };
    ((turn * (SECTORS / 4) as f64) as usize).min(SECTORS - 1)
}

/// A column of the dual: a point that touches the outer (`sign` 1) or the inner circle (-1).
#[derive(Clone, Copy)]
struct DualColumn {
    ray: usize,
    sign: f64,
}

/// The shift of the minimum zone's centre from `centre`, to first order.
fn shift(rays: &[RadialMeasurement], centre: [f64; 2]) -> Option<[f64; 2]> {
    /// Exchanges before Bland's rule, which cannot cycle, takes over, and before the search is given up.
    const FAST: usize = 60;
    const MAX_ZONE_EXCHANGES: usize = 2000;
    let row = |column: DualColumn| {
        let ray = rays[column.ray];
        let (reach, [x, y]) = ray.reach(centre);
        // deviation(centre + d) = deviation + unit . d: the zone is |deviation - offset + unit . d| <= half.
        (
            Vector4::new(-x * column.sign, -y * column.sign, column.sign, 1.0),
            column.sign * (ray.length_mm - reach),
        )
    };
    let [i, j, k] = spread(rays, centre)?;
    let mut basis = [(i, 1.0), (i, -1.0), (j, 1.0), (k, 1.0)].map(|(ray, sign)| DualColumn { ray, sign });
    for round in 0..MAX_ZONE_EXCHANGES {
        let mut matrix = Matrix4::zeros();
        let mut costs = Vector4::zeros();
        for (at, &column) in basis.iter().enumerate() {
            let (gradient, cost) = row(column);
            matrix.set_column(at, &gradient);
            costs[at] = cost;
        }
        let inverse = matrix.try_inverse()?;
        // x, y, offset and half width of the zone through the basis.
        let solved = inverse.transpose() * costs;
        let solved = solved + inverse.transpose() * (costs - matrix.transpose() * solved);
        let [x, y, offset, half] = [solved[0], solved[1], solved[2], solved[3]];
        let mut entering: Option<(DualColumn, f64)> = None;
        for (at, ray) in rays.iter().enumerate() {
            let (reach, unit) = ray.reach(centre);
            let rest = ray.length_mm - reach + unit[0] * x + unit[1] * y - offset;
            let beyond = rest.abs() - half;
            if beyond > entering.map_or(CONVERGED_MM, |(_, most)| most) {
                entering = Some((DualColumn { ray: at, sign: rest.signum() }, beyond));
                if round > FAST {
                    break;
                }
            }
        }
        let Some((entering, _)) = entering else { return Some([x, y]) };
        let weights = inverse * Vector4::new(0.0, 0.0, 0.0, 1.0);
        let change = inverse * row(entering).0;
        let leaving = (0..4)
            .filter(|&at| change[at] > 1e-12)
            .map(|at| (at, weights[at].max(0.0) / change[at]))
            .min_by(|a, b| a.1.total_cmp(&b.1).then(basis[a.0].ray.cmp(&basis[b.0].ray)))?;
        basis[leaving.0] = entering;
    }
    None
}

/// Three points in distant directions.
fn spread(rays: &[RadialMeasurement], centre: [f64; 2]) -> Option<[usize; 3]> {
    let [ax, ay] = rays.first()?.reach(centre).1;
    let best = |merit: &dyn Fn([f64; 2]) -> f64| {
        let merits = rays.iter().map(|ray| merit(ray.reach(centre).1)).enumerate();
        merits.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|best| best.1 > 1e-9).map(|best| best.0)
    };
    let second = best(&|[x, y]| (x - ax).hypot(y - ay))?;
    let [bx, by] = rays[second].reach(centre).1;
    let third = best(&|[x, y]| ((bx - ax) * (y - ay) - (by - ay) * (x - ax)).abs())?;
    Some([0, second, third])
}
