/* ${name}, as its wrapper knows it. */
#ifndef MODEL_H
#define MODEL_H

#include "${header}"

#define MODEL_TOKEN "${token}"
#define MODEL_STATES ${name}_STATES
#define MODEL_REFERENCES ${name}_REFERENCES
#define MODEL_KEPT ${kept}
#define MODEL_PERIOD ${name}_PERIOD
#define MODEL_PERIOD_TEXT "${period}"
#define MODEL_START ${start}

#define model_state ${part}_state
#define model_init ${part}_init
#define model_valid ${name}_valid
#define model_guarded_step ${step}

#endif
