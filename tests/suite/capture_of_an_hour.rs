//! A minute at 1 kHz through every command; `cargo bench --bench hour` measures an hour.

#[path = "../../benches/hour/verbs.rs"]
mod verbs;

#[test]
fn a_minute_goes_through_every_verb() {
    verbs::run(verbs::HOUR / 60, 1);
}
