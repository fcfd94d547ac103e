//! A minute at 1 kHz through every command; `cargo bench --bench hour` measures an hour.

#[path = "../../benches/hour/verbs.rs"]
mod verbs;

#[test]
fn a_minute_goes_through_every_verb() {
    verbs::run(verbs::HOUR / 60, 1);
}

/// 13 bytes stay of a sample; before, 80 were needed while the clock of the device was mapped.
#[test]
#[cfg(target_os = "linux")]
fn matching_takes_few_bytes_of_a_sample() {
    let [short_mb, long_mb] = [1, 7].map(|minutes| verbs::sync_peak_mb(minutes * verbs::HOUR / 60));
    let bytes = (long_mb - short_mb) * 1024.0 * 1024.0 / (6.0 * verbs::HOUR as f64 / 60.0);
    assert!(bytes < 40.0, "{bytes:.0} bytes, {short_mb:.1} and {long_mb:.1} MB");
}

/// `cargo test --release --test suite -- an_hour_is_matched --ignored`
#[test]
#[cfg(target_os = "linux")]
#[ignore = "writes 340 MB"]
fn an_hour_is_matched_within_its_memory() {
    let peak_mb = verbs::sync_peak_mb(verbs::HOUR);
    assert!(peak_mb < 96.0, "{peak_mb:.1} MB");
}
