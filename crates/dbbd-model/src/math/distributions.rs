//! Upper tails and quantiles. F and Student's t use the regularised incomplete beta function, chi-square and the normal
//! distribution the regularised incomplete gamma function. Both are short continued fractions, so no further crate is
//! needed.

/// Probability that F with `upper` and `lower` degrees of freedom exceeds `f`.
fn f_tail(f: f64, upper: f64, lower: f64) -> f64 {
    if f <= 0.0 { 1.0 } else { beta(lower / (lower + upper * f), 0.5 * lower, 0.5 * upper) }
}

/// Natural logarithm of the tail of F; it is finite also where the probability underflows.
pub fn ln_f_tail(f: f64, upper: f64, lower: f64) -> f64 {
    if f <= 0.0 {
        return 0.0;
    }
    let (x, a, b) = (lower / (lower + upper * f), 0.5 * lower, 0.5 * upper);
    if x > (a + 1.0) / (a + b + 2.0) {
        beta(x, a, b).ln()
    } else {
        ln_front(x, a, b) - fraction(x, a, b).ln()
    }
}

/// The value that F with `upper` and `lower` degrees of freedom exceeds with probability `p`.
pub fn f_exceeded(p: f64, upper: f64, lower: f64) -> f64 {
    crossing(10.0, |f| f_tail(f, upper, lower) > p)
}

/// The lower degrees of freedom with which F exceeds `f` with probability `p`; `None` if chi-square over its freedom exceeds `f`
/// as often.
pub fn lower_freedom(p: f64, upper: f64, f: f64) -> Option<f64> {
    let is_normal = chi_square_tail(upper * f, upper) >= p;
    (!is_normal).then(|| crossing(100.0, |lower| f_tail(f, upper, lower) > p))
}

/// The standard normal deviate whose two-sided tail probability has the natural logarithm `ln_p`; at least 1.
pub fn normal_deviate(ln_p: f64) -> f64 {
    // Mills' ratio by Laplace's continued fraction (DLMF 7.9.3), evaluated from its end.
    let mills = |z: f64| (1..=MILLS_TERMS).rev().fold(z, |rest, k| z + f64::from(k) / rest).recip();
    let ln_tail = |z: f64| 0.5 * (2.0 / std::f64::consts::PI).ln() - 0.5 * z * z + mills(z).ln();
    let mut z = (-2.0 * ln_p).max(1.0).sqrt();
    for _ in 0..NEWTON_STEPS {
        // Newton's method: the derivative of ln_tail is -1 / mills.
        z = (z + (ln_tail(z) - ln_p) * mills(z)).max(1.0);
    }
    z
}

/// Two-sided tail probability of `deviate`: Student's t with `freedom` degrees of freedom, normal without.
pub fn two_sided_tail(deviate: f64, freedom: Option<f64>) -> f64 {
    match freedom {
        Some(freedom) => f_tail(deviate * deviate, 1.0, freedom),
        None => chi_square_tail(deviate * deviate, 1.0),
    }
}

/// Probability that chi-square with `freedom` degrees of freedom exceeds `x`: Q(freedom / 2, x / 2) (DLMF 8.2.4).
pub fn chi_square_tail(x: f64, freedom: f64) -> f64 {
    let (a, x) = (0.5 * freedom, 0.5 * x);
    if x.is_nan() || x <= 0.0 {
        return if x.is_nan() { f64::NAN } else { 1.0 };
    }
    let front = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 { 1.0 - front * gamma_series(x, a) } else { front / gamma_fraction(x, a) }
}

/// The quantile of chi-square that is exceeded with probability `p`.
pub fn chi_square_exceeded(p: f64, freedom: f64) -> f64 {
    crossing(freedom + 10.0, |x| chi_square_tail(x, freedom) > p)
}

/// Probability that a noncentral chi-square exceeds `x`: a Poisson mixture of central ones.
pub fn noncentral_tail(x: f64, freedom: f64, noncentrality: f64) -> f64 {
    let half = 0.5 * noncentrality;
    if half <= 0.0 {
        return chi_square_tail(x, freedom);
    }
    // Terms more than ten standard deviations from the mean of the Poisson distribution are negligible.
    let (low, high) = ((half - 10.0 * half.sqrt()).max(0.0).floor(), half + 10.0 * half.sqrt() + 30.0);
    let mut sum = 0.0;
    let mut term = low;
    while term <= high {
        let weight = (term * half.ln() - half - ln_gamma(term + 1.0)).exp();
        sum += weight * chi_square_tail(x, freedom + 2.0 * term);
        term += 1.0;
    }
    sum.min(1.0)
}

/// The noncentrality with which noncentral chi-square exceeds `x` with probability `power`.
pub fn noncentrality(x: f64, freedom: f64, power: f64) -> f64 {
    crossing(x + 10.0, |lambda| noncentral_tail(x, freedom, lambda) < power)
}

/// The argument at which `is_below`, true at 0, becomes false, by bisection; `high` is a first guess of an upper bound.
fn crossing(mut high: f64, is_below: impl Fn(f64) -> bool) -> f64 {
    let most = 1e6 * high;
    while high < most && is_below(high) {
        high *= 2.0;
    }
    let mut low = 0.0;
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if is_below(middle) { low = middle } else { high = middle }
    }
    high
}

/// The series of DLMF 8.7.1 without its factor x^a e^-x / gamma(a), for x < a + 1.
fn gamma_series(x: f64, a: f64) -> f64 {
    let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
    for _ in 0..1000 {
        n += 1.0;
        term *= x / n;
        sum += term;
        if term < 1e-17 * sum {
            break;
        }
    }
    sum
}

/// The reciprocal of the continued fraction of DLMF 8.9.2 without the same factor, for x >= a + 1.
fn gamma_fraction(x: f64, a: f64) -> f64 {
    let first = x + 1.0 - a;
    continued(first, |n| [-n * (n - a), first + 2.0 * n])
}

/// The continued fraction b0 + a1 / (b1 + a2 / (b2 + ..)) by Lentz's algorithm (Thompson and Barnett, J. Comput. Phys. 64,
/// 1986); `term(n)` is [an, bn].
fn continued(first: f64, term: impl Fn(f64) -> [f64; 2]) -> f64 {
    const TINY: f64 = 1e-300;
    let away = |value: f64| if value.abs() < TINY { TINY } else { value };
    let (mut value, mut c, mut d) = (first, first, 0.0);
    for n in 1..=1000 {
        let [numerator, denominator] = term(f64::from(n));
        d = 1.0 / away(denominator + numerator * d);
        c = away(denominator + numerator / c);
        value *= c * d;
        if (c * d - 1.0).abs() < 1e-15 {
            break;
        }
    }
    value
}

const MILLS_TERMS: u32 = 100;
const NEWTON_STEPS: usize = 20;

/// The result of a two-sided chi-square test, each side at 0.001.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChiSquareOutcome {
    Less,
    AsExpected,
    Greater,
}

impl ChiSquareOutcome {
    /// `ratio` is chi-square over its degrees of freedom (normal approximation of Wilson and Hilferty, PNAS 17, 1931).
    pub fn of(ratio: f64, freedom: f64) -> Self {
        let spread = (2.0 / (9.0 * freedom)).sqrt();
        let bound = |z: f64| (1.0 - spread * spread + z * spread).powi(3);
        if ratio > bound(3.09) {
            Self::Greater
        } else if ratio < bound(-3.09) {
            Self::Less
        } else {
            Self::AsExpected
        }
    }
}

/// Coverage factor of a 95 % interval of a normal quantity, in the four figures of GUM:2008, table G.2 (infinite degrees of
/// freedom). Intervals of files and pages are made with it; [`coverage_95`] has all digits.
pub const COVERAGE_95: f64 = 1.96;

/// Coverage factor of an expanded uncertainty, k = 2: about 95 % (GUM:2008, 6.3.3 and G.6.6).
pub const COVERAGE_FACTOR: f64 = 2.0;

/// Density of the standard normal distribution at its quantile 0.975, exp(-1.96^2 / 2) / sqrt(2 pi) = 0.0584.
pub const NORMAL_DENSITY_AT_975: f64 = 0.058_4;

/// Ratio of the 97.5 % quantiles of Student's t and of the normal distribution by three terms in the reciprocal of the degrees
/// of freedom, at least 3 (Abramowitz and Stegun 26.7.5, at 1.96). It is 1 % too small at three degrees of freedom.
pub fn coverage_95_ratio(freedom: f64) -> f64 {
    let [one, two, three] = [1.210_4, 1.440_1, 1.304];
    let f = freedom.max(3.0);
    1.0 + (one + (two + three / f) / f) / f
}

/// Coverage factor of a 95 % interval: Student's t if the standard deviation was estimated with `freedom` degrees of
/// freedom, else normal.
pub fn coverage_95(freedom: Option<f64>) -> f64 {
    const NORMAL: f64 = 1.959_963_984_540_054;
    let Some(freedom) = freedom else { return NORMAL };
    let outside = |t: f64| beta(freedom / (freedom + t * t), 0.5 * freedom, 0.5);
    crossing(NORMAL, |t| outside(t) > 0.05)
}

/// Probability of at least this number of successes in independent trials (DLMF 8.17.5).
pub fn binomial_tail(successes: usize, trials: usize, chance: f64) -> f64 {
    match successes {
        0 => 1.0,
        _ if successes > trials => 0.0,
        _ => beta(chance, successes as f64, (trials - successes + 1) as f64),
    }
}

/// The regularised incomplete beta function I_x(a, b) (DLMF 8.17), for 0 <= x <= 1 and positive a, b.
fn beta(x: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    if x >= 1.0 {
        return 1.0;
    }
    // The continued fraction converges fast below the mean of the distribution; above it, that of the complement does.
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - beta(1.0 - x, b, a);
    }
    ln_front(x, a, b).exp() / fraction(x, a, b)
}

/// Logarithm of the factor in front of the continued fraction.
fn ln_front(x: f64, a: f64, b: f64) -> f64 {
    a * x.ln() + b * (-x).ln_1p() + ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) - a.ln()
}

/// The continued fraction of DLMF 8.17.22.
fn fraction(x: f64, a: f64, b: f64) -> f64 {
    continued(1.0, |n| {
        let m = (0.5 * n).floor();
        let numerator = if n % 2.0 == 0.0 {
            m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m))
        } else {
            -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0))
        };
        [numerator, 1.0]
    })
}

/// Logarithm of the gamma function for x > 0 (Stirling's series after shifting x above 10, DLMF 5.11.1).
pub(crate) fn ln_gamma(x: f64) -> f64 {
    let (mut x, mut shift) = (x, 0.0);
    while x < 10.0 {
        shift -= x.ln();
        x += 1.0;
    }
    let inverse = 1.0 / (x * x);
    let series = (1.0 / 12.0
        + inverse * (-1.0 / 360.0 + inverse * (1.0 / 1260.0 + inverse * (-1.0 / 1680.0 + inverse / 1188.0))))
        / x;
    shift + (x - 0.5) * x.ln() - x + 0.5 * std::f64::consts::TAU.ln() + series
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums of C(n, k) p^k (1 - p)^(n - k) in exact arithmetic: 1 - 0.9^2 for one of two.
    #[test]
    fn tail_of_the_binomial_distribution() {
        for (successes, trials, chance, expected) in [
            (1, 2, 0.1, 0.19),
            (5, 12, 0.1, 0.004_329_343_27),
            (7, 24, 0.1, 0.007_456_146_938_263),
            (3, 3, 0.5, 0.125),
            (0, 3, 0.1, 1.0),
            (4, 3, 0.1, 0.0),
        ] {
            let found = binomial_tail(successes, trials, chance);
            assert!((found - expected).abs() < 1e-14, "{successes} of {trials}: {found}");
        }
    }

    /// Values of scipy.stats.f.sf.
    #[test]
    fn tail_of_f() {
        for (f, upper, lower, expected) in [
            (1.0, 4.0, 210.0, 0.408559421519459),
            (0.5, 12.0, 60.0, 0.9065875723782626),
            (3.2, 12.0, 200.0, 0.0003255764394410984),
            (7.5, 4.0, 40.0, 0.00013189119067580723),
            (35.0, 12.0, 250.0, 8.631548630213195e-47),
            (60.0, 4.0, 1000.0, 1.9027496968283392e-45),
            (2.0, 1.0, 1.0, 0.39182655203060723),
            (0.01, 3.0, 7.0, 0.9984952470401116),
        ] {
            let found = f_tail(f, upper, lower);
            assert!((found / expected - 1.0).abs() < 1e-10, "{f}, {upper}, {lower}: {found} for {expected}");
        }
        assert_eq!(f_tail(0.0, 3.0, 4.0), 1.0);
    }

    /// Values of scipy.stats.f.isf.
    #[test]
    fn quantile_of_f_and_its_degrees_of_freedom() {
        for (lower, expected) in
            [(5.0, 5.409451318056488), (20.0, 3.098391212140781), (700.0, 2.6176267081914637)]
        {
            let found = f_exceeded(0.05, 3.0, lower);
            assert!((found / expected - 1.0).abs() < 1e-9, "{lower}: {found}");
            let back = lower_freedom(0.05, 3.0, found).unwrap();
            assert!((back / lower - 1.0).abs() < 1e-6, "{lower}: {back}");
        }
        let normal = chi_square_exceeded(0.05, 3.0) / 3.0;
        assert_eq!(lower_freedom(0.05, 3.0, 0.999 * normal), None);
    }

    #[test]
    fn logarithm_of_the_tail_is_finite_where_the_tail_underflows() {
        for (f, upper, lower) in [(0.5, 12.0, 60.0), (3.2, 12.0, 200.0), (60.0, 4.0, 1000.0)] {
            let (tail, ln) = (f_tail(f, upper, lower), ln_f_tail(f, upper, lower));
            assert!((ln - tail.ln()).abs() < 1e-10 * ln.abs().max(1.0));
        }
        assert!(ln_f_tail(1e6, 4.0, 1000.0) < -1000.0);
    }

    /// Values of scipy.stats.norm.isf(p / 2).
    #[test]
    fn normal_deviate_of_a_probability() {
        for (p, expected) in [(0.05, 1.959963984540054), (1e-3, 3.290526731491926), (1e-15, 8.02685888253454)]
        {
            let found = normal_deviate(f64::ln(p));
            assert!((found - expected).abs() < 1e-9, "{p}: {found}");
        }
        assert!((normal_deviate(-5000.0) - 99.94).abs() < 0.05);
    }

    /// scipy.stats.chi2.ppf([0.001, 0.999], 100) / 100 are 0.61918 and 1.49449.
    #[test]
    fn a_ratio_is_as_expected_between_both_quantiles() {
        for (ratio, expected) in [
            (0.617, ChiSquareOutcome::Less),
            (0.621, ChiSquareOutcome::AsExpected),
            (1.0, ChiSquareOutcome::AsExpected),
            (1.493, ChiSquareOutcome::AsExpected),
            (1.497, ChiSquareOutcome::Greater),
        ] {
            assert_eq!(ChiSquareOutcome::of(ratio, 100.0), expected, "{ratio}");
        }
    }

    /// 2 scipy.stats.t.sf(2.5, 7) and 2 scipy.stats.norm.sf(2.5).
    #[test]
    fn two_sided_tails_match_scipy() {
        assert!((two_sided_tail(-2.5, Some(7.0)) - 0.04099221858575289).abs() < 1e-12);
        assert!((two_sided_tail(2.5, None) - 0.012419330651552265).abs() < 1e-13);
    }

    /// Values of scipy.stats.chi2.sf and scipy.stats.ncx2.sf.
    #[test]
    fn tails_of_chi_square() {
        for (x, freedom, expected) in [
            (0.5, 1.0, 0.47950012218695337),
            (6.6348966010212145, 1.0, 0.009999999999999972),
            (3.0, 12.0, 0.9955440192247521),
            (30.0, 12.0, 0.0027924293327009145),
            (150.0, 100.0, 0.0009039320423540184),
            (40.0, 2.0, 2.0611536224385566e-09),
        ] {
            let found = chi_square_tail(x, freedom);
            assert!((found / expected - 1.0).abs() < 1e-10, "{x}, {freedom}: {found} for {expected}");
            assert!((chi_square_exceeded(expected, freedom) / x - 1.0).abs() < 1e-9);
        }
        for (x, freedom, lambda, expected) in [
            (26.2, 12.0, 10.0, 0.2728490047149872),
            (50.9, 30.0, 35.5, 0.8501496046151135),
            (6.63, 1.0, 17.8, 0.949924909165437),
        ] {
            let found = noncentral_tail(x, freedom, lambda);
            assert!(
                (found / expected - 1.0).abs() < 1e-9,
                "{x}, {freedom}, {lambda}: {found} for {expected}"
            );
            assert!((noncentrality(x, freedom, expected) / lambda - 1.0).abs() < 1e-7);
        }
    }

    /// Values of scipy.stats.t.ppf(0.975, ..).
    #[test]
    fn half_width_of_a_95_percent_interval() {
        for (freedom, expected) in [
            (1.0, 12.706204736174694),
            (2.0, 4.302652729749462),
            (5.0, 2.5705818356363146),
            (30.0, 2.0422724563012378),
            (200.0, 1.9718962236339088),
            (10000.0, 1.960201239890626),
        ] {
            assert!((coverage_95(Some(freedom)) / expected - 1.0).abs() < 1e-10, "{freedom}");
        }
        assert!((coverage_95(None) - COVERAGE_95).abs() < 1e-4);
        // scipy.stats.norm.pdf(scipy.stats.norm.ppf(0.975)) = 0.058450.
        assert!((NORMAL_DENSITY_AT_975 - 0.058450).abs() < 1e-4);
    }

    /// scipy.stats.t.ppf(0.975, ..) / scipy.stats.norm.ppf(0.975).
    #[test]
    fn ratio_of_student_and_normal() {
        for (freedom, expected, relative) in
            [(3.0, 1.6237, 0.013), (5.0, 1.3115, 0.002), (10.0, 1.1368, 3e-4), (30.0, 1.0420, 1e-4)]
        {
            assert!((coverage_95_ratio(freedom) / expected - 1.0).abs() < relative, "{freedom}");
        }
        assert_eq!(coverage_95_ratio(1.0), coverage_95_ratio(3.0));
    }
}
