//! The minimum zone: the two concentric circles, of least radial distance, between which all points lie.
//!
//! About a given centre the problem is a linear programme in centre, offset and half width. It is
//! solved in its dual by the simplex method: a basis of four points, exchanged one by one for the
//! point that the zone misses most. Where the centre moves, the distances are taken anew, until it rests.

use nalgebra::{Matrix4, Vector4};

use super::fit::Ray;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zone {
    /// Its centre: the base ball, seen from the programmed centre, mm.
    pub centre: [f64; 2],
    pub width_mm: f64,
}

/// Angular sectors whose outermost points stand for all at first.
const SECTORS: usize = 360;
/// Above this many points sectors pay.
const MANY: usize = 2 * SECTORS;
/// Changes of the centre, and misses of the zone, below this are none, mm: some rounding steps of a length.
const RESTS_MM: f64 = 1e-11;

/// The minimum zone, searched from `centre` (that of the least-squares circle). `None` when the points
/// have fewer than three directions.
pub fn minimum_zone(rays: &[Ray], centre: [f64; 2]) -> Option<Zone> {
    if rays.len() <= MANY {
        return rest(rays, centre);
    }
    let mut zone = Zone { centre, width_mm: 0.0 };
    let mut chosen: Vec<usize> = Vec::new();
    loop {
        let before = chosen.len();
        chosen.extend(outermost(rays, zone.centre));
        chosen.sort_unstable();
        chosen.dedup();
        if chosen.len() == before {
            return Some(zone);
        }
        let few: Vec<Ray> = chosen.iter().map(|&at| rays[at]).collect();
        zone = rest(&few, zone.centre)?;
        if width(rays, zone.centre) - zone.width_mm < RESTS_MM {
            return Some(zone);
        }
    }
}

/// Repeats the linear programme until the centre rests.
fn rest(rays: &[Ray], mut centre: [f64; 2]) -> Option<Zone> {
    for _ in 0..20 {
        let [x, y] = shift(rays, centre)?;
        centre = [centre[0] + x, centre[1] + y];
        if x.hypot(y) < RESTS_MM {
            break;
        }
    }
    Some(Zone { centre, width_mm: width(rays, centre) })
}

/// Distance between the circles about `centre` that hold all points, mm.
pub(super) fn width(rays: &[Ray], centre: [f64; 2]) -> f64 {
    let [low, high] = extremes(rays, centre);
    high - low
}

/// Least and greatest deviation about `centre`, mm.
pub(super) fn extremes(rays: &[Ray], centre: [f64; 2]) -> [f64; 2] {
    rays.iter()
        .map(|ray| ray.deviation(centre))
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], d| [low.min(d), high.max(d)])
}

/// For each sector the points with the least and the greatest deviation.
pub(super) fn outermost(rays: &[Ray], centre: [f64; 2]) -> Vec<usize> {
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

/// The sector of a direction. Any numbering that grows with the angle serves: this one needs no arctangent.
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

/// A column of the dual: a point as one that touches the outer (`sign` 1) or the inner circle (-1).
#[derive(Clone, Copy)]
struct Column {
    ray: usize,
    sign: f64,
}

/// By how much the minimum zone's centre differs from `centre`, to first order.
fn shift(rays: &[Ray], centre: [f64; 2]) -> Option<[f64; 2]> {
    /// Exchanges before the rule that cannot cycle takes over, and before the search is given up.
    const FAST: usize = 60;
    const MOST: usize = 2000;
    let row = |column: Column| {
        let ray = rays[column.ray];
        let (reach, [x, y]) = ray.reach(centre);
        // deviation(centre + d) = deviation + unit . d: the zone is |deviation - offset + unit . d| <= half.
        (
            Vector4::new(-x * column.sign, -y * column.sign, column.sign, 1.0),
            column.sign * (ray.length_mm - reach),
        )
    };
    let [i, j, k] = spread(rays, centre)?;
    let mut basis = [(i, 1.0), (i, -1.0), (j, 1.0), (k, 1.0)].map(|(ray, sign)| Column { ray, sign });
    for round in 0..MOST {
        let mut matrix = Matrix4::zeros();
        let mut costs = Vector4::zeros();
        for (at, &column) in basis.iter().enumerate() {
            let (gradient, cost) = row(column);
            matrix.set_column(at, &gradient);
            costs[at] = cost;
        }
        let inverse = matrix.try_inverse()?;
        // x, y, offset, half width of the zone that the basis touches.
        let solved = inverse.transpose() * costs;
        let solved = solved + inverse.transpose() * (costs - matrix.transpose() * solved);
        let [x, y, offset, half] = [solved[0], solved[1], solved[2], solved[3]];
        let mut entering: Option<(Column, f64)> = None;
        for (at, ray) in rays.iter().enumerate() {
            let (reach, unit) = ray.reach(centre);
            let rest = ray.length_mm - reach + unit[0] * x + unit[1] * y - offset;
            let beyond = rest.abs() - half;
            if beyond > entering.map_or(RESTS_MM, |(_, most)| most) {
                entering = Some((Column { ray: at, sign: rest.signum() }, beyond));
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

/// Three points in directions far apart.
fn spread(rays: &[Ray], centre: [f64; 2]) -> Option<[usize; 3]> {
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
