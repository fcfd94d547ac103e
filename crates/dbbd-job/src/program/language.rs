//! The languages of robot controllers, and how their files are recognised.

use dbbd_model::robot::{AXES, Robot};

/// A language of robot programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Language {
    /// KUKA.
    Krl,
    /// ABB.
    Rapid,
    /// Universal Robots.
    Urscript,
    /// FANUC: the listing of a TP program.
    Fanuc,
}

impl Language {
    pub const ALL: [Self; 4] = [Self::Krl, Self::Rapid, Self::Urscript, Self::Fanuc];

    /// The name in robot files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Krl => "krl",
            Self::Rapid => "rapid",
            Self::Urscript => "urscript",
            Self::Fanuc => "fanuc",
        }
    }

    /// The name as users of the language write it.
    pub(crate) fn title(self) -> &'static str {
        match self {
            Self::Krl => "KRL",
            Self::Rapid => "RAPID",
            Self::Urscript => "URScript",
            Self::Fanuc => "FANUC TP",
        }
    }

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|language| language.name() == name)
    }

    /// The extensions of program files, in lower case.
    fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Krl => &["src", "dat"],
            Self::Rapid => &["mod", "modx", "sys", "sysx", "prg"],
            Self::Urscript => &["script"],
            Self::Fanuc => &["ls"],
        }
    }

    /// The language of a file with this extension.
    pub fn of_extension(extension: &str) -> Option<Self> {
        let has_extension =
            |language: &Self| language.extensions().iter().any(|e| e.eq_ignore_ascii_case(extension));
        Self::ALL.into_iter().find(has_extension)
    }

    /// The language of a text, by the line that begins its first routine or module.
    pub fn of_text(text: &str) -> Option<Self> {
        let begun_by = |line: &str| Self::ALL.into_iter().find(|language| language.begins(line));
        text.split_inclusive('\n').find_map(begun_by)
    }

    /// The sign that begins a comment.
    pub fn comment(self) -> char {
        match self {
            Self::Krl => ';',
            Self::Rapid | Self::Fanuc => '!',
            Self::Urscript => '#',
        }
    }

    /// Whether a whole line begins a routine, a data list, a module or the statements of a TP program.
    pub(crate) fn begins(self, line: &str) -> bool {
        let mut words = line.split_ascii_whitespace();
        let first = words.next().unwrap_or("");
        let ends = line.ends_with('\n');
        match self {
            // The line `def` of URScript ends with a colon.
            Self::Krl => {
                let upper = |word: &str| word.to_ascii_uppercase();
                let word = if upper(first) == "GLOBAL" { words.next().unwrap_or("") } else { first };
                ends && ["DEF", "DEFFCT", "DEFDAT"].contains(&upper(word).as_str())
                    && !line.trim_end().ends_with(':')
            }
            Self::Rapid => ends && first.eq_ignore_ascii_case("MODULE"),
            Self::Urscript => ends && first == "def" && line.trim_end().ends_with(':'),
            Self::Fanuc => ends && first == "/MN",
        }
    }

    /// The home position of the robots with this language, degrees.
    pub(crate) fn home_deg(self) -> [f64; AXES] {
        match self {
            Self::Krl => [0.0, -90.0, 90.0, 0.0, 0.0, 0.0],
            Self::Rapid => [0.0; AXES],
            Self::Urscript => [0.0, -90.0, 0.0, -90.0, 0.0, 0.0],
            // The wrist points down.
            Self::Fanuc => [0.0, 0.0, 0.0, 0.0, -90.0, 0.0],
        }
    }

    /// The language of a robot's controller; KRL if it is unknown, because the simulated KRL controller moves any robot.
    pub fn of_robot(robot: &Robot) -> Self {
        robot.controller_language().and_then(Self::named).unwrap_or(Self::Krl)
    }
}
