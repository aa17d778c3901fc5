// Body of load_nodes in memory.py for registers of $lanes lanes, of x in the number type $given.
typedef wp::$given other;
typedef other others __attribute__((ext_vector_type($lanes), aligned(sizeof(other))));
const auto at = x.data + offset, run_at = x.data + (offset + ~node.c[0]);
const others r = node.c[0] < 0 ? *reinterpret_cast<const others*>(run_at) : others{$each};
return as_value(__builtin_convertvector(r, run));
