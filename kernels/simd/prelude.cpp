// Beginning of every native function: numbers of the type $real in registers of $lanes lanes.
typedef wp::$real number;
typedef number run $attributes;
typedef run* runs;
typedef $register value;
const int lanes = $lanes;
const auto as_value = [](run r) { return *reinterpret_cast<value*>(&r); };
