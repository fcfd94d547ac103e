//! No more points than the eye can tell apart: a plot of a million would not open.

/// Beyond so many points a plot shows the least and the largest in each of `BINS` strips.
const MOST: usize = 4000;
const BINS: usize = 1000;

/// The points to draw: all, or where they are many, in each strip along x those of least and largest y.
pub(super) fn thinned<T>(points: Vec<&T>, place: impl Fn(&T) -> [f64; 2]) -> Vec<&T> {
    if points.len() <= MOST {
        return points;
    }
    let (first, last) = points
        .iter()
        .map(|point| place(point)[0])
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    let mut ends: Vec<Option<[&T; 2]>> = vec![None; BINS];
    for point in points {
        let [x, y] = place(point);
        let share = ((x - first) / (last - first)).clamp(0.0, 1.0);
        let Some(end) = ends.get_mut(((share * BINS as f64) as usize).min(BINS - 1)) else { continue };
        let [low, high] = end.get_or_insert([point, point]);
        if y < place(low)[1] {
            *low = point;
        }
        if y > place(high)[1] {
            *high = point;
        }
    }
    ends.into_iter().flatten().flatten().collect()
}
