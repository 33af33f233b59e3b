/* ${name}, as its wrapper knows it. */
#ifndef MODEL_H
#define MODEL_H

#include "${name}_guard.h"

#define MODEL_TOKEN "${token}"
#define MODEL_STATES ${name}_STATES
#define MODEL_REFERENCES ${name}_REFERENCES
#define MODEL_KEPT ${kept}
#define MODEL_PERIOD ${name}_PERIOD
#define MODEL_PERIOD_TEXT "${period}"
#define MODEL_START ${start}

#define model_state ${name}_state
#define model_init ${name}_init
#define model_valid ${name}_valid
#define model_guarded_step ${name}_guarded_step

#endif
