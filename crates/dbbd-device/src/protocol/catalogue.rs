//! Protocol definitions: TOML files that describe how a bar's bytes become lengths.

use dbbd_model::findings;

findings! {
    /// A definition that contradicts itself, or a protocol that is not there.
    ProtocolFinding "Protocol definitions" {
        E0301 "there is no such protocol",
        cause: "The name is mistyped, or the file is not where it is looked for.",
        cure: "`dbbd protocols list` names what is built in; a file ends in .toml.",
        asks: [Zero] {
            UnknownProtocol { name: String, built_in: String } => "no protocol `{name}`: neither built in nor a file", help: "built in are: {built_in}; a file ends in .toml";
            NoZeroCommand { id: String } => "the protocol `{id}` has no command that sets the zero ([cmd] zero)";
        }
        E0302 "the definition as a whole is not valid",
        cause: "The file is of another schema, has no id, or has nothing to decode.",
        cure: "Compare with a complete definition: `dbbd protocols show dbb-cobs-1`; docs/reference/protocols.md has every key." {
            UnknownSchema { schema: u32 } => "schema {schema} is not known", help: "this dbbd reads schema 1";
            EmptyId => "the id is empty";
            NoMessage => "no [[message]]: nothing would be decoded";
            EmptyIgnore => "an empty prefix would pass over everything";
        }
        E0303 "[line], [mode] and [timing] do not agree",
        cause: "A key has a value that no serial line can have, is missing, or belongs to another kind of device.",
        cure: "Set the keys that the kind of device needs: a polled device has poll_hz, reply_timeout_ms and [cmd] poll." {
            BaudZero => "[line]: baud must not be 0";
            ProbeZero => "[line]: baud_probe must not have a 0";
            DataBits => "[line]: bits must be 7 or 8";
            StopBits => "[line]: stop must be 1 or 2";
            PollKeysWithoutPoll => "[mode]: poll_hz and reply_timeout_ms belong to kind = \"poll\"";
            PollKeysMissing => "[mode]: kind = \"poll\" needs poll_hz and reply_timeout_ms";
            PollCommandMissing => "[mode]: kind = \"poll\" needs [cmd] poll: what asks for a reading";
            PollRate => "poll_hz must be above 0 and at most 10000";
            NominalRate => "nominal_hz must be above 0 and at most 1e6";
            LatchDevice => "latch = \"device\" needs a field with role = \"t_dev\"";
            LatchRequest => "latch = \"request\" needs [mode] kind = \"poll\"";
        }
        E0304 "[framing] is not valid",
        cause: "A frame's begin, end or length is missing, longer than the decoder takes, or contradicts another key.",
        cure: "Correct the key that the message names; lengths are bytes with all wrapping." {
            LineStart => "[framing]: start must be one ASCII character";
            LineEnds => "[framing]: end must list one or more line ends of 1 to 4 bytes";
            DelimiterEnd => "[framing]: end must be 1 to 4 bytes in hexadecimal";
            FixedSync => "[framing]: sync must be hexadecimal and shorter than len";
            LengthSync => "[framing]: sync must be hexadecimal, and end before len_at";
            LengthField => "[framing]: len_bytes must be 1 or 2, len_at and len_adds below 4096";
            TagCount => "[framing]: data_bits must be 1 to 7, and tags 1 to 16";
            TagBits { tag: String, bits: u32 } => "[framing]: tag `{tag}` must have {bits} bits";
            TagLetterApart { letter: char } => "[framing]: the bits of `{letter}` are not adjacent";
            TagSymbol { symbol: char } => "[framing]: `{symbol}` in a tag: 0, 1 or a letter";
            TagLettersDiffer => "[framing]: the letters must be at the same bits in every tag";
            GapKeys => "[framing]: a gap needs `len = [..]`, or `idle_us` and `max_len`";
            MaxLength => "[framing]: max_len must be 8 to 4096 bytes";
        }
        E0305 "[check] is not valid",
        cause: "The check of a frame lacks a key, has one that its kind does not take, or its parameters give another CRC.",
        cure: "Name a CRC of the catalogue, or give all of its parameters with its check value." {
            ParametersWithoutCrc => "[check]: only a crc has a name or parameters";
            NameAndParameters => "[check]: give a crc by name or by parameters, not both";
            ParametersMissing => "[check]: a crc needs a name, or all of its parameters", help: "width, poly, init, refin, refout, xorout, and check: the CRC over \"123456789\", which is verified";
            CrcWidth => "[check]: width must be 8, 16, 24 or 32";
            CrcDiffers { check: u32 } => "these CRC parameters give check {check:#x}", help: "check is the CRC over the nine characters 123456789: a parameter or this value is wrong";
            UnknownCrc { name: String, known: String } => "no CRC `{name}` in the catalogue", help: "known are: {known}; others are given by width, poly, init, .. and check";
            AfterCharacter => "after must be one ASCII character";
            OptionalWithoutAfter => "[check]: optional needs `after`: the character that shows whether there is a check";
            EncodingMissing => "[check]: enc is missing: le, be or hex";
        }
        E0306 "a message does not fit its frame",
        cause: "The fields of a message are longer or shorter than the frame, a role is there twice or not at all, or a byte belongs to two of them.",
        cure: "Count the bytes: `dbbd protocols show NAME` prints the layout of a definition that is valid. Bytes of the framing and of `match` are fields of kind `skip`." {
            RoleCount { message: String, role: &'static str, count: usize } => "message `{message}`: {count} fields have role `{role}`; a message has exactly one length and at most one of the others";
            TooLong { message: String, bytes: usize, room: usize } => "message `{message}`: its fields need {bytes} bytes, the frame has room for {room}";
            OtherLength { message: String, bytes: usize, room: usize } => "message `{message}`: its fields have {bytes} bytes, the frame has {room}";
            NoFixedLength { message: String, room: usize } => "message `{message}`: its fields have no fixed number of bytes, the frame has {room}";
            FramingByte { message: String, byte: usize } => "message `{message}`: byte {byte} belongs to the framing: it must be in a field of kind `skip`";
            MatchedByte { byte: usize } => "byte {byte} is not in a field of kind `skip`", help: "a byte that is matched belongs to no other field; positions count from 0";
            BitGroup { bits: u32 } => "{bits} bits follow each other: a group is 8, 16, 24 or 32 bits";
        }
        E0307 "a field's keys do not agree",
        cause: "A key is missing, out of its range, or has no meaning in a field of this kind and role.",
        cure: "docs/reference/protocols.md lists the keys of each kind and role." {
            KeyWithoutMeaning { key: String } => "`{key}` has no meaning in a field of this kind and role";
            KeyType { key: String, why: String } => "`{key}`: {why}";
            SkipBytes => "skip needs `bytes`, at least 1";
            IntegerBits => "an integer needs `bits`: 8, 16, 24 or 32";
            IntegerEndian => "an integer of several bytes needs `endian`: le, be, cdab or badc";
            WordOrder => "`endian` cdab and badc are orders of the two words of 32 bits";
            FloatBits => "a float needs `bits`: 32 or 64, and `endian`: le, be, cdab or badc";
            BitsBits => "bits needs `bits`, 1 to 32";
            LiteralText => "lit needs `text`";
            DecimalWidth => "decimals must be at most 12, width and pad_to at most 32";
            DecimalMark => "`decimal` must be \".\" or \",\"";
            ReadDecimals => "`read_decimals` gives the smallest and the largest number of decimals of each unit, as in mm = [2, 4]";
            BlankFill => "fill = \"blank\" needs blanks = true: what is written must be read";
            HexDigits => "hex needs `digits`, 1 to 8";
            MapWords => "map needs `map`: words and what they mean";
            MapDefault => "map needs either `optional = true` or `default`: the word of the map that is written";
            MapRole => "a field of kind `map` has role unit, status or none";
            ColumnSeparator => "column needs `sep`: one ASCII character";
            RoleWithoutValue => "a field without a value has no role";
            SequenceModulo { bits: u32 } => "seq needs `modulo`: from 2 to 2^{bits}";
            ClockKeys { bits: u32 } => "t_dev needs `tick_ns`, at least 1, and `wrap_bits`: 8 to {bits}";
            ClockDecimals => "t_dev: `tick_ns` is the time of 1, and must be a whole number of nanoseconds for the last of its `decimals`";
            FlagBit { bit: String, highest: u32 } => "flag `{bit}` is not a bit of the field: 0 to {highest}";
            QualityRange => "quality needs `valid`: [lowest, highest], the lowest above 0";
            UnitKind => "a unit is a field of kind `map`";
            UnitWords => "a unit's words mean mm, um, inch or fault";
            UnitWithoutMm => "a unit needs a word for mm";
            TooManyWords => "more than 32 different words";
            SentinelNumber { value: String } => "sentinel `{value}` is not a number";
            ValidRange => "valid must be [lowest, highest]";
            CountScale => "unit count needs `per`: how many counts make a millimetre";
            LengthUnit => "a length needs `unit`: um, mm, inch, count or device";
            TemperatureUnit => "a temp needs `unit`: C";
            ScaleZero => "scale_num and scale_den must not be 0";
            ScaleFactors => "offset must be a number, times and per numbers other than 0";
        }
        E0308 "a [[reject]] is not valid",
        cause: "A device's code for having no reading is empty, or its codes cannot follow it.",
        cure: "Give one of `prefix`, `eq` and `hex`; a `code` follows a prefix or hex, and `map` names codes." {
            RejectText => "[[reject]]: needs one of `prefix`, `eq` and `hex`, not empty";
            RejectCode => "[[reject]]: a `code` follows a prefix, and `map` needs a code";
            RejectNumber { code: String } => "[[reject]]: `{code}` is not a code";
        }
        E0309 "a step of a command is not valid",
        cause: "A step of [cmd] has none or several actions, or an answer is expected of a step that sends nothing.",
        cure: "One action a step; `expect` and `timeout_ms` stay with the step that sends." {
            StepActions => "a step has exactly one of send, hex, wait_ms, drain_ms, dtr_pulse_ms";
            StepHex => "hex is not pairs of hexadecimal digits";
            StepSendsNothing => "`check` and `expect` belong to a step that sends";
            StepCheck => "`check` needs a [check]";
            StepExpect => "`expect` needs `timeout_ms`, and they belong together";
            IdentAnswer => "ident needs a step with `expect`: what the device answers";
            ProbeIdent => "baud_probe needs [cmd] ident: what shows the right rate";
        }
        E0310 "a parameter of the definition is not valid",
        cause: "A parameter is unknown, or its value is not of its type or out of its range.",
        cure: "`dbbd protocols show NAME` prints [params] with types and ranges; give those that differ.",
        asks: [ProtocolParameter] {
            UnknownParameter { name: String, known: String } => "no parameter `{name}`", help: "[params] has: {known}";
            NoParameters { name: String } => "no parameter `{name}`", help: "the definition has no [params]";
            ParameterNotANumber { name: String, value: String } => "parameter `{name}` = `{value}`: not a number";
            ParameterNotWhole { name: String, value: String } => "parameter `{name}` = `{value}`: not a whole number";
            ParameterRange { name: String, value: String, least: f64, most: f64 } => "parameter `{name}` = `{value}`: must be {least} to {most}";
            ParameterWord { name: String, value: String, known: String } => "parameter `{name}` = `{value}`: must be one of: {known}";
            BraceOpen => "the brace of a parameter is not closed";
            ParameterFormat { format: String, value: String } => "`{format}` is not a format for `{value}`";
        }
        E0311 "a test vector of the definition fails",
        cause: "The bytes of a [[test]] do not give what it expects: a key of the definition or the test is wrong.",
        cure: "Compare with what the bytes give, which the message says, and with the device's manual." {
            VectorHex => "rx is not pairs of hexadecimal digits";
            VectorDiffers { got: String } => "the test's bytes give {got}";
            VectorHasMore { got: String } => "the test's bytes give {got} that is not expected";
            VectorDoesNotSurvive => "the sample of this test does not survive writing and reading", help: "a field is too short, or has too few decimals, for what the device sends";
        }
        W0390 "a definition has no test vectors",
        cause: "The file has no [[test]] with bytes of the device and the readings that they mean, so that nothing shows that they are read as the device means them.",
        cure: "Add a [[test]] with bytes from the maker's manual, or with bytes that were recorded at a length that you know." {
            NoTests => "has no [[test]]: nothing shows that it reads what the device sends";
        }
        W0391 "a definition has the id of a built-in one",
        cause: "The file was copied from a built-in definition and changed. Captures and jobs name a definition by its id, and the built-in one would be taken for it.",
        cure: "Give the definition an id of its own." {
            IdOfBuiltIn { id: String } => "has the id `{id}` of a built-in definition, and is another one";
        }
        E0312 "a sample cannot be written in this protocol",
        cause: "The protocol has no room for a value of the sample: a reading beyond what its field can hold, or a value that is not there.",
        cure: "Simulate a bar within the range of its protocol, or another protocol." {
            FieldDoesNotFit { field: &'static str } => "the sample's {field} is missing or does not fit the protocol's field";
            FrameTooLong { bytes: usize } => "the frame is {bytes} bytes long, more than the protocol's max_len";
        }
    }
}
