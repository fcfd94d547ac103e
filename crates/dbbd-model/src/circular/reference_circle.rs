//! The reference circles of ISO 230-4: by least squares and by the minimum zone.
//!
//! The least-squares circle has exact distances. Removing the centre linearly would leave e^2 / (2 R) of a set-up error e in
//! the data.
//!
//! The minimum zone are the two concentric circles of least radial distance between which all points lie.
//!
//! Linearised about a centre, the problem is a linear programme in centre, offset and half width. Its dual is solved by
//! the simplex method: in a basis of four points, one is exchanged in each step for the point farthest outside the
//! zone. The linearisation is repeated until the centre does not move.

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

/// A programmed point relative to the programmed centre, and the length measured there, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RadialMeasurement {
    pub(super) point: [f64; 2],
    pub(super) length_mm: f64,
}

/// The least-squares circle: length = |point - centre| + offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FittedCircle {
    /// The base ball relative to the programmed centre, mm.
    pub(super) centre: [f64; 2],
    /// Mean radial deviation, mm.
    pub(super) offset_mm: f64,
    /// Condition number of the three columns, each scaled to unit norm.
    pub(super) condition: f64,
    /// Covariance of centre and offset for lengths of unit variance.
    pub(super) covariance: Matrix3<f64>,
}

impl RadialMeasurement {
    /// Distance from `centre` to the programmed point, mm, and the unit vector there.
    #[inline]
    pub(super) fn reach(&self, centre: [f64; 2]) -> (f64, [f64; 2]) {
        let (x, y) = (self.point[0] - centre[0], self.point[1] - centre[1]);
        // `hypot` guards against overflow, which does not occur here, and is several times slower.
        let reach = (x * x + y * y).sqrt();
        (reach, [x / reach, y / reach])
    }

    /// Length less the distance from `centre`, mm.
    #[inline]
    pub(super) fn deviation(&self, centre: [f64; 2]) -> f64 {
        self.length_mm - self.reach(centre).0
    }
}

/// Largest number of Gauss-Newton steps.
const MAX_GAUSS_NEWTON_STEPS: usize = 20;

/// Fits centre and offset by Gauss-Newton from the programmed centre. `None` if the points do not determine them (fewer
/// than three directions) or the iteration does not converge.
pub(super) fn fit_circle(rays: impl Iterator<Item = RadialMeasurement> + Clone) -> Option<FittedCircle> {
    let mut centre = [0.0; 2];
    for _ in 0..MAX_GAUSS_NEWTON_STEPS {
        let mut normal = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for ray in rays.clone() {
            let (reach, [x, y]) = ray.reach(centre);
            let row = Vector3::new(-x, -y, 1.0);
            normal += row * row.transpose();
            right += row * (ray.length_mm - reach);
        }
        let covariance = normal.try_inverse()?;
        let solved = covariance * right;
        // One refinement removes the rounding error of the inverse.
        let step = solved + covariance * (right - normal * solved);
        centre = [centre[0] + step[0], centre[1] + step[1]];
        let moved = step[0].hypot(step[1]);
        if !moved.is_finite() {
            return None;
        }
        if moved < 1e-11 {
            return Some(FittedCircle {
                centre,
                offset_mm: step[2],
                condition: condition(&normal)?,
                covariance,
            });
        }
    }
    None
}

fn condition(normal: &Matrix3<f64>) -> Option<f64> {
    let scale = normal.diagonal().map(f64::sqrt);
    let scaled = Matrix3::from_fn(|i, j| normal[(i, j)] / (scale[i] * scale[j]));
    let values = scaled.symmetric_eigenvalues();
    let (least, most) = (values.min(), values.max());
    let condition = (most / least).sqrt();
    (least > 0.0 && condition.is_finite()).then_some(condition)
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MinimumZone {
    /// The base ball relative to the programmed centre, mm.
    pub(super) centre: [f64; 2],
    pub(super) width_mm: f64,
}

/// Angular sectors whose outermost points are the first candidates.
const SECTORS: usize = 360;
/// The sectors save time if there are more points than this.
const MANY: usize = 2 * SECTORS;
/// Convergence limit of centre and zone, mm: a few rounding errors of a length.
const CONVERGED_MM: f64 = 1e-11;

/// The minimum zone, starting at the centre of the least-squares circle. `None` if the points have fewer than three
/// directions.
pub(super) fn minimum_zone(rays: &[RadialMeasurement], centre: [f64; 2]) -> Option<MinimumZone> {
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

#[cfg(test)]
mod tests {
    use super::*;

    const RADIUS_MM: f64 = 150.0;

    fn ray(angle_deg: f64, deviation_mm: f64) -> RadialMeasurement {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let point = [RADIUS_MM * cos, RADIUS_MM * sin];
        RadialMeasurement { point, length_mm: RADIUS_MM + deviation_mm }
    }

    /// Half a circle of seven points.
    fn half_circle() -> Vec<RadialMeasurement> {
        let deviations = [0.01, -0.02, 0.03, 0.005, -0.01, 0.02, 0.015];
        deviations.iter().enumerate().map(|(at, deviation)| ray(30.0 * at as f64, *deviation)).collect()
    }

    /// Gauss-Newton steps by numpy.linalg.lstsq of hypot(x - a, y - b) + D = L; numpy.linalg.cond of the three columns of the Jacobian,
    /// each of unit norm, and the inverse of J'J.
    #[test]
    fn least_squares_circle_matches_numpy() {
        let found = fit_circle(half_circle().into_iter()).unwrap();
        let [x, y] = found.centre;
        for (value, expected) in
            [(x, 0.00491019259120396), (y, 0.00429272066041432), (found.offset_mm, 0.00943145211509035)]
        {
            assert!((value - expected).abs() < 1e-10, "{value} for {expected}");
        }
        assert!((found.condition - 3.1264932612835037).abs() < 1e-8);
        for (at, expected) in [
            ((0, 0), 0.24999576825998135),
            ((1, 1), 0.9897941995016543),
            ((1, 2), 0.5276927051371777),
            ((2, 2), 0.4241879399500068),
        ] {
            assert!((found.covariance[at] - expected).abs() < 1e-8, "{at:?}");
        }
    }

    #[test]
    fn an_exact_circle_is_found_from_afar() {
        let centre = [3.0, -2.0];
        let rays = (0..12).map(|at| {
            let ray = ray(30.0 * f64::from(at), 0.0);
            RadialMeasurement { length_mm: ray.reach(centre).0 + 0.25, ..ray }
        });
        let rays: Vec<RadialMeasurement> = rays.collect();
        let found = fit_circle(rays.iter().copied()).unwrap();
        assert!((found.centre[0] - 3.0).abs() < 1e-11 && (found.centre[1] + 2.0).abs() < 1e-11);
        assert!((found.offset_mm - 0.25).abs() < 1e-11);
        assert!(width(&rays, found.centre) < 1e-11 && (rays[3].deviation(centre) - 0.25).abs() < 1e-12);
        // Two directions do not determine a circle.
        assert!(fit_circle([ray(0.0, 0.0), ray(0.0, 0.1), ray(90.0, 0.0)].into_iter()).is_none());
    }

    /// The linear programme of the minimum zone by scipy.optimize.linprog, repeated about its centre.
    #[test]
    fn minimum_zone_matches_scipy() {
        let found = minimum_zone(&half_circle(), [0.0; 2]).unwrap();
        assert!((found.width_mm - 0.04183016868176992).abs() < 1e-9, "{found:?}");
        assert!((found.centre[0] - 0.00183038521355731).abs() < 1e-8);
        assert!((found.centre[1] + 0.02049190580472822).abs() < 1e-8);
        assert!(
            found.width_mm <= width(&half_circle(), fit_circle(half_circle().into_iter()).unwrap().centre)
        );
        assert!(minimum_zone(&[ray(0.0, 0.0), ray(90.0, 0.0)], [0.0; 2]).is_none());
    }

    #[test]
    fn the_zone_of_many_points_is_that_of_all() {
        // An oval of +-0.02 mm with a ripple of 0.003 mm, about a ball that is off by 0.4 and -0.3 mm.
        let centre = [0.4, -0.3];
        let rays: Vec<RadialMeasurement> = (0..MANY + 80)
            .map(|at| {
                let angle_deg = 360.0 * at as f64 / (MANY + 80) as f64;
                let theta = angle_deg.to_radians();
                let ray = ray(angle_deg, 0.0);
                let form = 0.02 * (2.0 * theta).cos() + 0.003 * (37.0 * theta).sin();
                RadialMeasurement { length_mm: ray.reach(centre).0 + form, ..ray }
            })
            .collect();
        let (few, all) = (minimum_zone(&rays, [0.0; 2]).unwrap(), converge(&rays, [0.0; 2]).unwrap());
        assert!((few.width_mm - all.width_mm).abs() < 1e-9, "{few:?} {all:?}");
        assert!((few.width_mm - width(&rays, few.centre)).abs() < 1e-12);
        assert!(few.width_mm > 0.04 && few.width_mm < 0.0461);
    }

    #[test]
    fn sectors_number_the_directions_in_order() {
        let at = |degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            sector(cos, sin)
        };
        assert_eq!(
            [1e-9, 45.0 + 1e-9, 90.0 + 1e-9, 180.0 + 1e-9, 270.0 + 1e-9].map(at),
            [0, 45, 90, 180, 270]
        );
        assert_eq!(at(359.99), SECTORS - 1);
        let sectors: Vec<usize> = (0..3600).map(|tenth| at(0.1 * f64::from(tenth) + 0.05)).collect();
        assert!(sectors.is_sorted() && sectors.windows(2).all(|pair| pair[1] - pair[0] <= 1));
        // |y| / (|x| + |y|) = 0.25 is a quarter of the first 90 sectors.
        assert_eq!(sector(3.0, 1.0), 22);
    }

    #[test]
    fn the_outermost_points_of_each_sector_are_kept() {
        let rays = [ray(10.1, 0.0), ray(10.2, 0.3), ray(10.3, -0.2), ray(200.0, 0.1), ray(10.15, 0.1)];
        assert_eq!(outermost(&rays, [0.0; 2]), [2, 1, 3, 3]);
        let [low, high] = extremes(&rays, [0.0; 2]);
        assert!((low + 0.2).abs() < 1e-12 && (high - 0.3).abs() < 1e-12);
        assert!((width(&rays, [0.0; 2]) - 0.5).abs() < 1e-12);
    }
}
