//! The maker of an arm: in what its controller differs from a description.

/// A maker whose controllers are known, or another one, whose controller shows the joints as a description has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Maker {
    Abb,
    Fanuc,
    Kuka,
    Staubli,
    Universal,
    Yaskawa,
    Other,
}

/// The words by which descriptions name an arm: its maker, or the beginning of a type that a number follows.
const WORDS: [(Maker, &[&str], &[&str]); 6] = [
    (Maker::Abb, &["abb"], &["irb"]),
    (Maker::Fanuc, &["fanuc"], &["lrmate", "crx"]),
    (Maker::Kuka, &["kuka"], &["kr"]),
    (Maker::Staubli, &["staubli", "stäubli"], &["tx", "rx"]),
    (Maker::Universal, &["universal", "universalrobots", "ur"], &["ur"]),
    (Maker::Yaskawa, &["yaskawa", "motoman"], &[]),
];

impl Maker {
    pub const ALL: [Self; 7] =
        [Self::Abb, Self::Fanuc, Self::Kuka, Self::Staubli, Self::Universal, Self::Yaskawa, Self::Other];

    pub fn name(self) -> &'static str {
        match self {
            Self::Abb => "abb",
            Self::Fanuc => "fanuc",
            Self::Kuka => "kuka",
            Self::Staubli => "staubli",
            Self::Universal => "universal",
            Self::Yaskawa => "yaskawa",
            Self::Other => "other",
        }
    }

    /// The maker with this name.
    pub fn of_word(word: &str) -> Option<Self> {
        let word = word.to_lowercase();
        let is_named = |(_, makers, _): &&(Self, &[&str], &[&str])| makers.contains(&word.as_str());
        WORDS.iter().find(is_named).map(|(maker, ..)| *maker)
    }

    /// The maker that a name or the name of a file names, also by a type; `None` if it names none, or several.
    pub fn named_in(text: &str) -> Option<Self> {
        let text = text.to_lowercase();
        let words = || text.split(|sign: char| !sign.is_alphanumeric());
        let is_type = |word: &str, start: &str| {
            word.strip_prefix(start).is_some_and(|rest| rest.starts_with(|sign: char| sign.is_ascii_digit()))
        };
        let is_named = |(_, makers, types): &&(Self, &[&str], &[&str])| {
            words().any(|word| makers.contains(&word) || types.iter().any(|start| is_type(word, start)))
        };
        let mut named = WORDS.iter().filter(is_named).map(|(maker, ..)| *maker);
        named.next().filter(|_| named.next().is_none())
    }

    /// The language of its controllers.
    pub fn language(self) -> Option<&'static str> {
        match self {
            Self::Abb => Some("rapid"),
            Self::Fanuc => Some("fanuc"),
            Self::Kuka => Some("krl"),
            Self::Staubli => Some("val3"),
            Self::Universal => Some("urscript"),
            Self::Yaskawa => Some("inform"),
            Self::Other => None,
        }
    }

    /// Whether axis 3 of an arm with one of these names is shown against the horizontal. Source: FANUC's manuals (J2/J3 interaction); for
    /// ABB's arms with a parallelogram the driver and the launch files of ROS-Industrial (`J23_coupled`).
    pub fn couples<'n>(self, mut names: impl Iterator<Item = &'n str>) -> bool {
        const PARALLELOGRAMS: [&str; 3] = ["irb2400", "irb4400", "irb5400"];
        let is_parallelogram =
            |name: &str| PARALLELOGRAMS.iter().any(|arm| name.to_lowercase().contains(arm));
        self == Self::Fanuc || self == Self::Abb && names.any(is_parallelogram)
    }

    /// Whether its controller counts from elsewhere than the foot of the arm. FANUC's World is in the height of axis 2, that of Universal
    /// Robots is turned by half a turn against REP 103 (the makers' ROS 2 descriptions have it as the link `base`).
    pub fn counts_elsewhere(self) -> bool {
        matches!(self, Self::Fanuc | Self::Universal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_maker_is_named_by_its_word_or_a_type() {
        for (text, maker) in [
            ("fanuc_m20id25", Some(Maker::Fanuc)),
            ("package://fanuc_m10ia_support/meshes/m10ia/visual/link_1.stl", Some(Maker::Fanuc)),
            ("LRMate200iD", Some(Maker::Fanuc)),
            ("ur5e_robot", Some(Maker::Universal)),
            ("UR10", Some(Maker::Universal)),
            ("our_robot", None),
            ("kr60ha", Some(Maker::Kuka)),
            ("st_ubli_tx2_60", Some(Maker::Staubli)),
            ("krypton", None),
            ("abb_irb2400", Some(Maker::Abb)),
            ("irb120_with_fanuc_gripper", None),
            ("arm", None),
        ] {
            assert_eq!(Maker::named_in(text), maker, "{text}");
        }
        // A word is a maker's name, and not a type.
        assert_eq!(
            [Maker::of_word("UR"), Maker::of_word("KUKA"), Maker::of_word("ur10")],
            [Some(Maker::Universal), Some(Maker::Kuka), None]
        );
    }
}
